"""Add up JUnit files into one report: test_report.py REPORT.json NAME=FILE.xml ..."""

import json
import sys
import xml.etree.ElementTree as ET
from pathlib import Path


def count(junit: Path) -> dict[str, float]:
    """Tests, failures (with errors), skipped ones and seconds of all suites in a file."""
    root = ET.parse(junit).getroot()
    suites = [root] if root.tag == "testsuite" else list(root.iter("testsuite"))

    def total(key: str) -> int:
        return sum(int(suite.get(key) or 0) for suite in suites)

    return {
        "tests": total("tests"),
        "failed": total("failures") + total("errors"),
        "skipped": total("skipped"),
        "time_s": round(sum(float(suite.get("time") or 0) for suite in suites), 1),
    }


def main(report: Path, inputs: list[str]) -> int:
    figures = {}
    for item in inputs:
        name, _, file = item.partition("=")
        figures |= {f"{name}_{key}": value for key, value in count(Path(file)).items()}
    report.parent.mkdir(parents=True, exist_ok=True)
    report.write_text(json.dumps(figures, indent=2, sort_keys=True) + "\n")
    return int(any(value for key, value in figures.items() if key.endswith("_failed")))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
