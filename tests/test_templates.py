"""Templates of issues and pull requests: well formed, and true about the repository."""

import re

import pytest
import yaml
from pages import ROOT

GITHUB = ROOT / ".github"
ISSUES = GITHUB / "ISSUE_TEMPLATE"
FORMS = sorted(path for path in ISSUES.glob("*.yml") if path.name != "config.yml")
KINDS = {"checkboxes", "dropdown", "input", "markdown", "textarea"}


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.stem)
def test_a_form_is_one_that_github_shows(form):
    content = yaml.safe_load(form.read_text())
    assert content["name"]
    assert content["description"]
    ids = [field["id"] for field in content["body"]]
    assert len(set(ids)) == len(ids)
    for field in content["body"]:
        assert field["type"] in KINDS
        assert field["attributes"]["label"]
    assert any(field.get("validations", {}).get("required") for field in content["body"])


def test_a_bug_needs_a_way_to_see_it_and_versions():
    body = yaml.safe_load((ISSUES / "bug.yml").read_text())["body"]
    needed = {field["id"] for field in body if field.get("validations", {}).get("required")}
    assert {"steps", "seen", "expected", "versions"} <= needed


def test_what_templates_name_is_there():
    targets = re.findall(r"^([\w-]+):(?!=)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for path in [*FORMS, GITHUB / "pull_request_template.md", ROOT / "RELEASING.md"]:
        text = path.read_text()
        for name in re.findall(r"`make ([\w -]+)`", text):
            assert set(name.split()) <= set(targets), path
        for name in re.findall(r"\b(?:docs/)?[\w-]+\.(?:md|txt|toml)\b", text):
            assert (ROOT / name).exists(), f"{path}: {name}"
