"""Settings: what is written reads back, later sources win, and a wrong one is refused with its name."""

from __future__ import annotations

import tomllib
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import pytest
from synthetic import HANDS

from aminn.model.checkpoint import build_model
from aminn.model.config import MECHANICS, TrainConfig, as_toml, load_config
from aminn_base.errors import AminnError


def test_toml_reads_back_with_every_description(tmp_path: Path) -> None:
    config = load_config(None, ["model.mechanics.eps_m=3e-5", "loss.relative=0.5", "model.heads=free"], seed=7)
    (tmp_path / "mine.toml").write_text(as_toml(config))
    assert load_config(tmp_path / "mine.toml") == config
    assert "# Peak of the schedule" in as_toml(config)


def test_every_setting_has_a_description() -> None:
    def check(config: object) -> None:
        for f in fields(config):
            value = getattr(config, f.name)
            assert type(config).__pydantic_fields__[f.name].description, f.name
            for inner in value if isinstance(value, tuple) else (value,):
                if is_dataclass(inner):
                    check(inner)

    check(TrainConfig())


def test_later_sources_win(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_text("epochs = 3\nbatch = 64\n[loss]\nrelative = 0.1\n")
    config = load_config(file, ["loss.gate=0"], epochs=5, kind=None)
    assert (config.epochs, config.batch, config.loss.relative, config.loss.gate) == (5, 64, 0.1, 0.0)


def test_one_mechanics_table_stands_for_both_stages_and_a_pair_for_each(tmp_path: Path) -> None:
    config = load_config(None, ["model.mechanics.dq0=inverse"])
    assert config.model.mechanics == tuple(replace(stage, dq0="inverse") for stage in MECHANICS)
    (tmp_path / "two.toml").write_text("[[model.mechanics]]\neps_m = 1e-4\n[[model.mechanics]]\neps_m = 1e-5\n")
    two = load_config(tmp_path / "two.toml").model.mechanics
    assert two == (replace(MECHANICS[0], eps_m=1e-4), replace(MECHANICS[1], eps_m=1e-5))


def test_what_differs_between_the_stages_is_printed_and_read_as_a_list_of_two(tmp_path: Path) -> None:
    config = load_config(None, ["model.mechanics.eps_m=[1e-4, 2e-4]"])
    assert [stage.eps_m for stage in config.model.mechanics] == [1e-4, 2e-4]
    text = as_toml(config)
    assert "eps_m = [0.0001, 0.0002]" in text and "eps_jq = 0.001\n" in text
    (tmp_path / "printed.toml").write_text(text)
    assert load_config(tmp_path / "printed.toml") == config


def test_one_width_stands_for_both_stages(tmp_path: Path) -> None:
    assert load_config(None, ["model.width=24"]).model.width == (24, 24)
    config = load_config(None, ["model.width=[8, 24]"])
    assert config.model.width == (8, 24)
    (tmp_path / "printed.toml").write_text(as_toml(config))
    assert load_config(tmp_path / "printed.toml") == config
    model = build_model("aminn", replace(config.model, sensors=False), HANDS["reference"])
    assert [part.backbone.trunk2.weight.shape for part in (model.stage1, model.stage2)] == [(8, 8), (24, 24)]


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["learning_rat=1"], "learning_rat is no setting; did you mean learning_rate"),
        (["colour=1"], "colour is no setting; there are kind, seed, epochs"),
        (["model.mechanics.epsm=1"], r"model\.mechanics\.epsm is no setting; did you mean model\.mechanics\.eps_m"),
        (["batch=0"], "batch: input should be greater than 0, not 0"),
        (["batch=many"], "batch: .*valid integer"),
        (["kind=forest"], "kind: .*'aminn' or 'mlp'"),
        (["loss.gate=-1"], r"loss\.gate: .*greater than or equal to 0"),
        (["learning_rate=nan"], "learning_rate: .*finite"),
        (["train_fraction=1.5"], "train_fraction: .*less than or equal to 1"),
        (["model.wrench_log_scale=[1, 2]"], r"model\.wrench_log_scale: .*6 positive numbers"),
        (["model.width=true"], r"model\.width: "),
        (["model.width=[8, 0]"], r"model\.width: .*greater than 0"),
        (["model.width=[8, 16, 24]"], r"model\.width: .*at most 2"),
        (["epochs"], "expected key=value"),
        (["epochs=3", "epochs.foo=3"], "epochs is a single value, not a table"),
    ],
)
def test_wrong_settings_are_refused(overrides: list[str], message: str) -> None:
    with pytest.raises(AminnError, match=message):
        load_config(None, overrides)


def test_a_file_that_is_no_toml_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("epochs = = 3")
    with pytest.raises(AminnError, match=r"bad\.toml: not valid TOML"):
        load_config(tmp_path / "bad.toml")


def test_printed_configuration_is_toml() -> None:
    assert tomllib.loads(as_toml(TrainConfig()))["loss"]["relative"] == TrainConfig().loss.relative
