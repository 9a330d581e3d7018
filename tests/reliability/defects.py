"""Seeded defects: what the campaigns on the runtime would have found.

defects.py --work build/defects --fuzz build/fuzz/fast --unity build/unity --report REPORT.json

Each defect is a change of one line, compiled into the program of the campaign that should find it. The sound library
goes through the same campaign, and must pass.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from aminn_base.files import write_json

ROOT = Path(__file__).resolve().parents[2]
RUNTIME = ROOT / "runtime"
TESTS = ROOT / "tests"
CORE = "src/cascade.cpp"
ARITHMETIC = "-fno-fast-math -fno-math-errno -fno-trapping-math -ffp-contract=off".split()
BARE = "-fno-exceptions -fno-rtti -fno-threadsafe-statics".split()
COVERAGE = ["-fsanitize-coverage=inline-8bit-counters,pc-table"]
ADDRESS = "-fsanitize=address,undefined -fno-sanitize-recover=all".split()
MODELS = ("aminn_model", "tiny_model", "half_model", "byte_model")
EXECUTIONS = 3_000_000
SECONDS = 120


@dataclass(frozen=True)
class Defect:
    """A change of one file below runtime/, and who must find it."""

    name: str
    file: str
    sound: str
    defect: str
    campaign: str
    compiled: tuple[str, ...] = ()
    """Sources that see the change; the file itself unless given."""

    @property
    def sources(self) -> tuple[str, ...]:
        return self.compiled or (self.file,)


DEFECTS = (
    Defect("crc_not_compared", "src/blob.cpp", "== header.crc", "== header.crc || true", "fuzz_blob"),
    Defect("bytes_behind_the_tables", "src/blob.cpp", "return at == len;", "return at <= len;", "fuzz_blob"),
    Defect(
        "width_zero_passes",
        "src/tables.hpp",
        "(*width - 1u) / AMINN_MAX_WIDTH",
        "*width / (AMINN_MAX_WIDTH + 1u)",
        "fuzz_blob",
        ("src/model.cpp", "src/blob.cpp"),
    ),
    Defect(
        "threshold_above_one_passes",
        "src/model.cpp",
        "within(m.tau, 0, kOneBits)",
        "within(m.tau, 0, kLargestBits)",
        "fuzz_blob",
    ),
    Defect(
        "last_number_may_be_nan",
        "src/input.cpp",
        "for (int i = 0; i < n; ++i)",
        "for (int i = 0; i < n - 1; ++i)",
        "fuzz_predict",
    ),
    Defect("flag_of_weight_unchecked", "src/sense.cpp", "ok &= is_flag(sensors.tool_weight[0]);", "", "fuzz_predict"),
    Defect(
        "theta_bound_off_by_one",
        "src/calibrate.cpp",
        "bool inside = true;\n    for (int i = 0; i < AMINN_N_THETA; ++i)",
        "bool inside = true;\n    for (int i = 0; i < AMINN_N_THETA - 1; ++i)",
        "fuzz_calibrate",
    ),
    Defect(
        "outputs_left_after_an_error",
        "src/predict.cpp",
        "        clear(*out);\n",
        "        if (status != AMINN_E_ROTATION) {\n            clear(*out);\n        }\n",
        "fuzz_predict",
    ),
    Defect(
        "margin_may_be_nan",
        "src/admissible.cpp",
        "l.margin >= 0.0F && l.margin <= FLT_MAX",
        "!(l.margin < 0.0F)",
        "fuzz_load",
    ),
    Defect(
        "covariance_lost_to_rounding",
        "src/calibrate_push.cpp",
        "known > 0.0F ? known : 0.0F;\n        const float least = kLeastDoubt * signal;",
        "known;\n        const float least = 0.0F;",
        "fuzz_calibrate",
    ),
    Defect(
        "row_takes_its_neighbours_theta",
        "host/batch.cpp",
        "theta.first + i * theta.step",
        "theta.first + (i > 0 ? i - 1 : 0) * theta.step",
        "fuzz_batch",
    ),
    Defect(
        "question_may_be_longer",
        "firmware/serial.c",
        "header.length > LARGEST_QUESTION",
        "header.length > LARGEST_QUESTION + 64",
        "fuzz_serial_sanitized",
    ),
    Defect(
        "answer_of_another_question",
        "firmware/serial.c",
        "answer((uint16_t)kind, sequence, &prediction",
        "answer((uint16_t)kind, sequence & 0xFFFFFF, &prediction",
        "fuzz_serial",
    ),
    Defect(
        "length_of_a_file_with_doubles",
        "tools/vector_file.h",
        "(uint64_t)h->n_out * 8u",
        "(uint64_t)h->n_out * 4u",
        "fuzz_vectors",
    ),
    Defect(
        "stiffness_not_symmetric",
        "src/mechanics.hpp",
        "k_x[i][k] = k_x[k][i] = row[k];",
        "k_x[k][i] = row[k];\n        k_x[i][k] = row[k] * 1.0000002F;",
        "properties",
        (CORE,),
    ),
    Defect(
        "slack_of_tendons_subtracted",
        "src/mechanics.hpp",
        "inv_gate / gain + rest_square",
        "inv_gate / gain - rest_square",
        "properties",
        (CORE,),
    ),
    Defect(
        "contact_fades_the_wrong_way",
        "src/grasp.hpp",
        "scatter(c * inv_d[i]",
        "scatter((2.5F - 1.5F * c) * c * inv_d[i]",
        "properties",
        (CORE,),
    ),
    Defect(
        "exponential_off_in_the_fifth_digit",
        "src/elementary.hpp",
        "0x1.55548ap-3F",
        "0x1.57548ap-3F",
        "differential",
        (CORE,),
    ),
    Defect(
        "sixteen_bytes_lost_at_each_error",
        "src/predict.cpp",
        "    if (out != nullptr) {\n        clear(*out);",
        (
            "    static void *volatile lost;\n"
            "    lost = __builtin_malloc(16);\n"
            "    (void)lost;\n"
            "    if (out != nullptr) {\n"
            "        clear(*out);"
        ),
        "realtime",
    ),
    Defect(
        "sixteen_bytes_lost_now_and_then",
        "src/predict.cpp",
        "    clear(out);\n    if (!AMINN_ON_BEST_CORE",
        (
            "    static unsigned calls;\n"
            "    if (++calls % 256 == 0) {\n"
            "        static void *volatile lost;\n"
            "        lost = __builtin_malloc(1600);\n"
            "        (void)lost;\n"
            "    }\n"
            "    clear(out);\n"
            "    if (!AMINN_ON_BEST_CORE"
        ),
        "soak",
    ),
    Defect(
        "bits_drift_after_ten_thousand",
        "src/predict.cpp",
        "    out.notes = in_training_range",
        (
            "    static unsigned calls;\n"
            "    out.condition = ++calls > 10000 ? out.condition * 1.0000002F : out.condition;\n"
            "    out.notes = in_training_range"
        ),
        "soak",
    ),
    Defect("workers_share_a_context", "host/batch.cpp", "    Worker worker;\n", "    static Worker worker;\n", "race"),
)


def run(command: list[object], seconds: int = 900, **more: object) -> subprocess.CompletedProcess[str]:
    """With standard error in the output."""
    return subprocess.run(  # type: ignore[call-overload]
        [str(c) for c in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=seconds,
        check=False,
        **more,
    )


def build(command: list[object]) -> None:
    """Compile or link; the message of the compiler where that fails."""
    done = run(command)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(map(str, command))}\n{done.stdout}")


class Place:
    """Where one variant of the runtime is compiled."""

    def __init__(self, tree: Path, work: Path, args: argparse.Namespace) -> None:
        self.tree, self.work, self.fuzz, self.unity = tree, work, args.fuzz, args.unity
        work.mkdir(parents=True, exist_ok=True)

    def includes(self) -> list[str]:
        folders = [
            *(self.tree / name for name in ("include", "src", "tools", "firmware")),
            TESTS / "runtime",
            TESTS / "golden",
        ]
        return [f"-I{folder}" for folder in folders] + [f'-DGOLDEN_DIR="{TESTS / "golden"}"']

    def compile(self, compiler: str, source: Path, flags: list[str], tag: str = "") -> Path:
        out = self.work / f"{source.stem}{tag}.o"
        standard = "-std=gnu99" if source.suffix == ".c" else "-std=c++17"
        build([compiler, standard, "-O1", "-g", *ARITHMETIC, *self.includes(), *flags, "-c", source, "-o", out])
        return out


def sources_of(place: Place, names: tuple[str, ...], compiler: str, flags: list[str]) -> list[Path]:
    """Objects of the runtime's sources that a defect changes."""
    plain = [name for name in names if name.startswith(("src/", "host/"))]
    return [place.compile(compiler, place.tree / name, [*flags, *BARE]) for name in plain]


def fuzz(place: Place, names: tuple[str, ...], campaign: str) -> tuple[bool, int]:
    """Whether a fuzz target found something, and after how many executions, from the seeds alone."""
    target, sanitized = campaign.removeprefix("fuzz_").removesuffix("_sanitized"), campaign.endswith("_sanitized")
    built = place.fuzz.parent / ("sanitized" if sanitized else "fast")
    flags = [*COVERAGE, *(ADDRESS if sanitized else ["-DAMINN_FUZZ_FAST"])]
    objects = sources_of(place, names, "clang++-14", flags)
    if target == "serial":
        model = ['-DMODEL_HEADER="aminn_model.h"', "-DMODEL_SYMBOL=aminn_model", "-DMODEL_SENSES"]
        objects.append(place.compile("clang-14", place.tree / "firmware/serial.c", [*flags, *model]))
    if target == "vectors":
        ends = ["-Dexit=fuzz_exit", "-Dposix_memalign=fuzz_memalign"]
        objects.append(place.compile("clang-14", place.tree / "tools/host_file.c", [*flags, *ends]))
    harness = place.compile("clang++-14", TESTS / "fuzz" / f"fuzz_{target}.cpp", flags[1:])
    program = place.work / campaign
    sanitizers = ADDRESS if sanitized else []
    libraries = [built / "libfuzz_support.a", *(built / f"aminn_rt/libaminn_rt{kind}.a" for kind in ("_host", ""))]
    build(["clang++-14", "-fsanitize=fuzzer", *sanitizers, harness, *objects, *libraries, "-lpthread", "-o", program])
    corpus = place.work / f"{campaign}_corpus"
    shutil.rmtree(corpus, ignore_errors=True)
    corpus.mkdir()
    seeds = place.fuzz.parent / "fast/seeds" / target
    limits = [
        f"-runs={EXECUTIONS}",
        f"-max_total_time={SECONDS}",
        "-max_len=16500" if target == "blob" else "-max_len=4096",
    ]
    done = run(
        [
            program,
            corpus,
            *([seeds] if seeds.is_dir() else []),
            *limits,
            "-seed=1",
            "-print_final_stats=1",
            f"-artifact_prefix={corpus}/",
        ]
    )
    count = re.findall(r"number_of_executed_units: (\d+)", done.stdout)
    return done.returncode != 0, int(count[-1]) if count else 0


def hand_header(work: Path, name: str, gated: int, slide: int) -> Path:
    """aminn_hand.h of a 3 x 3 hand, as tests/runtime makes it."""
    text = (TESTS / "runtime/hand.h.in").read_text()
    joints = "".join(f' X("joint_{i}")' for i in range(8))
    theta = "".join(f' X("theta_{i}")' for i in range(20))
    values = {
        "AMINN_HAND_NAME": name,
        "BRANCHES": 3,
        "COORDINATES": 3,
        "JOINTS": 8,
        "GATED": gated,
        "TWIST": 0,
        "SLIDE": slide,
    }
    for key, value in (values | {"STIFF": 8, "JOINT_NAMES": joints, "THETA_NAMES": theta}).items():
        text = text.replace(f"@{key}@", str(value))
    header = work / f"{name}.h"
    header.write_text(text)
    return header


def properties(place: Place, names: tuple[str, ...], campaign: str) -> tuple[bool, int]:
    """Whether the laws are broken, and about how many cases it takes."""
    hand = [
        f'-DAMINN_HAND_HEADER="{hand_header(place.work, "hand", 3, 0)}"',
        f"-I{place.unity / 'src'}",
        "-DUNITY_INCLUDE_DOUBLE",
    ]
    core = place.tree / CORE
    objects = [
        place.compile("g++", core, [*hand, *BARE, "-DAMINN_CORE=core_plain", "-DAMINN_RT_SCALAR"], "_plain"),
        place.compile("g++", core, [*hand, *BARE, "-DAMINN_CORE=core_vector"], "_vector"),
        place.compile("g++", TESTS / "runtime/test_hands.cpp", hand),
        place.compile("gcc", place.unity / "src/unity.c", ["-DUNITY_INCLUDE_DOUBLE"]),
    ]
    program = place.work / campaign
    build(["g++", *objects, "-lm", "-o", program])
    done = run([program, "--properties", 20000])
    laws = json.loads(done.stdout.splitlines()[-1])
    cases, broken = (max(v for k, v in laws.items() if k.endswith(kind)) for kind in ("_cases", "_broken"))
    return done.returncode != 0, cases // broken if broken else cases


def library(place: Place, names: tuple[str, ...]) -> list[Path]:
    """The library and models as objects, those that a defect changes compiled anew."""
    if place.tree != RUNTIME:
        sound = Place(RUNTIME, place.work.parent / "sound", argparse.Namespace(fuzz=place.fuzz, unity=place.unity))
        others = [o for o in library(sound, ()) if o.name not in {f"{Path(name).stem}.o" for name in names}]
        return sources_of(place, names, "g++", []) + others
    wanted = [*sorted(RUNTIME.glob("src/*.cpp")), RUNTIME / "host/batch.cpp", RUNTIME / "tools/host_file.c"]
    wanted += [TESTS / "golden" / f"{model}.c" for model in MODELS]
    objects = []
    for source in wanted:
        done = place.work / f"{source.stem}.o"
        compiler, flags = ("gcc", ["-D_GNU_SOURCE"]) if source.suffix == ".c" else ("g++", BARE)
        objects.append(done if done.is_file() else place.compile(compiler, source, flags))
    return objects


def soak(place: Place, names: tuple[str, ...], campaign: str) -> tuple[bool, int]:
    """Whether memory grows or a bit changes, and in how many predictions."""
    main = place.compile("gcc", TESTS / "runtime/soak.c", ["-D_GNU_SOURCE"])
    program = place.work / campaign
    build(["g++", main, *library(place, names), "-lm", "-lpthread", "-o", program])
    done = run([program, 200000, 2])
    return done.returncode != 0, int(json.loads(done.stdout.splitlines()[-1])["soak_predictions"])


def realtime(place: Place, names: tuple[str, ...], campaign: str) -> tuple[bool, int]:
    """Whether clang's real-time sanitizer has something to say; calls that it saw."""
    main = place.compile("clang++-22", TESTS / "runtime/realtime.cpp", ["-fsanitize=realtime"])
    program = place.work / campaign
    build(["clang++-22", "-fsanitize=realtime", main, *library(place, names), "-lm", "-lpthread", "-o", program])
    done = run([program])
    if done.returncode == 0:
        return False, int(json.loads(done.stdout.splitlines()[-1])["realtime_calls"])
    return "RealtimeSanitizer: unsafe-library-call" in done.stdout, 0


def race(place: Place, names: tuple[str, ...], campaign: str) -> tuple[bool, int]:
    """Whether the thread sanitizer finds a race in batches; predictions that it saw."""
    thread = ["-fsanitize=thread"]
    main = place.compile("gcc", TESTS / "runtime/soak.c", [*thread, "-D_GNU_SOURCE"])
    batch = place.compile("g++", place.tree / "host/batch.cpp", [*thread, *BARE], "_tsan")
    rest = [o for o in library(place, names) if o.name != "batch.o"]
    program = place.work / campaign
    build(["g++", *thread, main, batch, *rest, "-lm", "-lpthread", "-o", program])
    done = run([program, 4000, 2], env={"TSAN_OPTIONS": "halt_on_error=1 exitcode=66", "PATH": "/usr/bin:/bin"})
    return done.returncode == 66, 4000


def differential(place: Place, names: tuple[str, ...], campaign: str) -> tuple[bool, int]:
    """Whether the runtime is further from ONNX Runtime than the judge's limits; states that were compared."""
    main = place.compile("gcc", place.tree / "tools/aminn_replay.c", ["-D_GNU_SOURCE"])
    program = place.work / campaign
    build(["g++", main, *library(place, names), "-lm", "-lpthread", "-o", program])
    report = place.work / "differential.json"
    report.unlink(missing_ok=True)
    script = ROOT / "tests/reliability/differential.py"
    command = [sys.executable, script, "--replay", program, "--states", 300, "--work", place.work, "--report", report]
    done = run(command, env={**os.environ, "PYTHONPATH": str(ROOT)})
    return done.returncode == 1 and report.is_file(), 300


CAMPAIGNS = {"properties": properties, "soak": soak, "realtime": realtime, "race": race, "differential": differential}


def seeded(defect: Defect, args: argparse.Namespace) -> Place:
    """A copy of the runtime with the defect in it."""
    tree = args.work / defect.name / "runtime"
    shutil.rmtree(tree, ignore_errors=True)
    shutil.copytree(RUNTIME, tree)
    text = (tree / defect.file).read_text()
    if text.count(defect.sound) < 1:
        raise SystemExit(f"{defect.name}: runtime/{defect.file} has no {defect.sound!r}")
    (tree / defect.file).write_text(text.replace(defect.sound, defect.defect, 1))
    return Place(tree, args.work / defect.name, args)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("--work", "--fuzz", "--unity", "--report"):
        parser.add_argument(name, type=Path, required=True)
    parser.add_argument("--only", action="append", help="a campaign of several; all unless given")
    args = parser.parse_args()
    args.work, args.fuzz, args.unity = args.work.resolve(), args.fuzz.resolve(), args.unity.resolve()
    chosen = [d for d in DEFECTS if not args.only or d.campaign in args.only]
    figures: dict[str, float] = json.loads(args.report.read_text()) if args.only and args.report.is_file() else {}
    wrong = 0
    sound = Place(RUNTIME, args.work / "sound", args)
    for campaign in dict.fromkeys(d.campaign for d in chosen):
        function = CAMPAIGNS.get(campaign, fuzz)
        found, n = function(sound, (), campaign) if function is not fuzz else (False, 0)
        figures[f"sound_{campaign}_findings"] = int(found)
        print(f"{campaign}, sound: {'FOUND SOMETHING' if found else 'nothing'}", flush=True)
        wrong += found
        for defect in (d for d in chosen if d.campaign == campaign):
            found, n = function(seeded(defect, args), defect.sources, campaign)
            print(f"{campaign}, {defect.name}: {f'found after {n}' if found else f'NOT FOUND in {n}'}", flush=True)
            figures |= {f"defect_{defect.name}_found": int(found), f"defect_{defect.name}_after": n}
            wrong += not found
            write_json(args.report, figures)
    found_by = [v for name, v in figures.items() if name.startswith("defect_") and name.endswith("_found")]
    figures |= {"defects_runtime_seeds": len(found_by), "defects_runtime_seeds_found": sum(found_by)}
    write_json(args.report, figures)
    print(f"{sum(found_by)} of {len(found_by)} seeded defects found: {args.report}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
