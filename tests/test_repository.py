"""What is written in two files of the repository is the same in both."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def found(pattern: str, file: str) -> list[str]:
    return re.findall(pattern, (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)


def test_the_citation_is_of_this_project():
    assert found(r"^version: (.+)$", "CITATION.cff") == [PROJECT["version"]]
    assert found(r"^license: (.+)$", "CITATION.cff") == [PROJECT["license"]]
    assert found(r'^  - name: "(.+)"$', "CITATION.cff") == [author["name"] for author in PROJECT["authors"]]


def test_style_is_checked_by_one_version_of_ruff():
    assert found(r"^    rev: v(.+)$", ".pre-commit-config.yaml") == found(r"^ruff==(.+)$", "constraints.txt")


def test_what_is_needed_has_a_tested_version():
    names = {re.match(r"[\w-]+", need)[0] for need in PROJECT["dependencies"]}
    assert names <= {name.lower().replace("_", "-") for name in found(r"^([\w-]+)==", "constraints.txt")}
