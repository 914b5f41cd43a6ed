"""What the README says can be done can be done."""

import re
from pathlib import Path

import yaml

from torchid.config import load_config
from torchid.model.whole_body import joint_table, whole_body

PROJECT = Path(__file__).resolve().parents[1]
README = (PROJECT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def test_python_examples_run(capsys):
    """The example runs as printed, from an empty namespace, and says a plausible error."""
    for code in blocks("python"):
        exec(compile(code, "README.md", "exec"), {})  # the README's own code, not a user's
    said = re.search(r"([\d.]+) mm on a trial", capsys.readouterr().out)
    assert said is not None and 0.5 < float(said[1]) < 10.0


def test_the_config_is_valid(tmp_path):
    """The example config loads once the files that it names exist."""
    for k, text in enumerate(blocks("yaml")):
        for trial in yaml.safe_load(text)["trials"]:
            for key in ("file", "forces"):
                (tmp_path / trial[key]).touch()
        path = tmp_path / f"config_{k}.yaml"
        path.write_text(text)
        assert load_config(path, ["geometry.solver=lbfgs"]).markers == "opencap"
    assert blocks("yaml")


def test_the_joint_table_is_the_models():
    """The published table is what the model prints."""
    published = re.search(r"<!-- joints -->\n(.*?)\n<!-- /joints -->", README, re.DOTALL)
    assert published is not None and published[1] == joint_table(whole_body(None, None))


def test_files_and_links_exist():
    """Scripts, folders and pictures that are named are there."""
    named = set(re.findall(r"scripts/[\w.]+", README)) | set(re.findall(r"\]\(([^)#]+)\)", README))
    assert {"scripts/demo", "scripts/test"} <= named
    assert not [name for name in sorted(named) if "://" not in name and not (PROJECT / name).exists()]
