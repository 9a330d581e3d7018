"""The configuration of the tests' data set: two shards, the second one shorter."""

SMALL = {"grasps": 6, "cases": 3, "seed": 7, "shard_grasps": 4, "noise_share": 0.3}

_OWN_OPTIONS = ("grasps", "cases", "seed", "shard_grasps")


def command_line(settings: dict[str, float]) -> list[str]:
    """Options of `aminn simulate` for a configuration."""
    own = [f"--{name.replace('_', '-')}={value}" for name, value in settings.items() if name in _OWN_OPTIONS]
    return own + [f"--set={name}={value}" for name, value in settings.items() if name not in _OWN_OPTIONS]
