"""The wheel holds all that a person needs: built here, and used in an empty folder."""

from __future__ import annotations

import email
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from metadata_hook import portable, urls

import lss_motion

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture
def lss(wheel, tmp_path):
    """Return what runs a program of the wheel, without the checkout, in an empty folder."""
    site, folder = tmp_path / "site", tmp_path / "empty"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    folder.mkdir()
    modules = {"lss-motion": "lss_motion.cli.main", "lss-play": "lss_motion.cli.play"}

    def run(program: str, *words: str, folder: Path = folder) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", modules[program], *words],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(site)},
            capture_output=True,
            text=True,
            check=False,
        )

    run.folder = folder
    where = "import lss_motion; print(lss_motion.__file__)"
    command = [sys.executable, "-c", where]
    shown = subprocess.run(
        command, cwd=folder, env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert shown.stdout.startswith(str(site)), "the wheel is what is tried, not the checkout"
    return run


def test_an_example_is_listed_written_and_played_in_an_empty_folder(lss):
    listed = lss("lss-motion", "example")
    rows = dict(line.split(maxsplit=1) for line in listed.stdout.splitlines())
    assert set(rows) == {
        path.stem
        for place in ("", "stages")
        for path in (ROOT / "sequences" / place).glob("*.yaml")
    }
    assert rows["wave"].startswith("The arm says hello")
    written = lss("lss-motion", "example", "wave")
    assert written.returncode == 0, written.stderr
    assert {"wave.yaml", "robots/desk_arm.yaml", "schema/sequence.schema.json"} <= {
        path.relative_to(lss.folder).as_posix() for path in lss.folder.rglob("*.*")
    }
    played = lss("lss-play", "wave.yaml", "--virtual")
    assert played.returncode == 0, played.stderr
    assert "wave: finished" in played.stdout


def test_the_guides_are_opened_and_are_no_examples(lss):
    pages = {path.stem for path in (ROOT / "sequences" / "guides").glob("*.md")}
    assert set(lss("lss-motion", "docs", "--list").stdout.split()) == pages
    shown = lss("lss-motion", "docs", "recipes")
    assert shown.stdout == (ROOT / "sequences" / "guides" / "recipes.md").read_text()
    package = lss.folder.parent / "site" / "lss_motion"
    assert not (package / "examples" / "guides").exists()
    assert (package / "examples" / "nodes" / "targets_ros2.py").is_file()


def test_every_example_is_written_whole(lss):
    """With the parts and robots of play lists, layers and gaits."""
    for path in sorted((ROOT / "sequences").glob("*.yaml")):
        folder = lss.folder / path.stem
        folder.mkdir()
        assert lss("lss-motion", "example", path.stem, folder=folder).returncode == 0
        original = lss_motion.load_sequence(path)
        written = lss_motion.load_sequence(folder / path.name)
        assert written == original
        assert written.robot_path is not None
        assert written.robot_path.is_relative_to(folder)
        for copy in folder.rglob("*.yaml"):
            first, _, _ = copy.read_text(encoding="utf-8").partition("\n")
            schema = copy.parent / first.removeprefix("# yaml-language-server: $schema=")
            assert schema.resolve().is_relative_to(folder)
            assert schema.is_file()


def test_an_edited_file_is_overwritten_with_force_only(lss):
    lss("lss-motion", "example", "wave")
    again = lss("lss-motion", "example", "fastest")
    assert again.stdout.splitlines()[0] == "wrote fastest.yaml", "an equal robot file is no hurdle"
    robot = lss.folder / "robots" / "desk_arm.yaml"
    original = robot.read_text(encoding="utf-8")
    robot.write_text("robot: mine\n", encoding="utf-8")
    (lss.folder / "wave.yaml").unlink()
    refused = lss("lss-motion", "example", "wave")
    assert refused.returncode == 2
    assert "desk_arm.yaml: exists already" in refused.stderr
    assert "--force" in refused.stderr
    assert robot.read_text(encoding="utf-8") == "robot: mine\n"
    assert not (lss.folder / "wave.yaml").exists(), "nothing is written by halves"
    assert lss("lss-motion", "example", "wave", "--force").returncode == 0
    assert robot.read_text(encoding="utf-8") == original


def test_an_unknown_example_is_answered_with_the_nearest_name(lss):
    refused = lss("lss-motion", "example", "wafe")
    assert refused.returncode == 2
    assert "did you mean 'wave'?" in refused.stderr


def test_the_wheel_has_types_version_programs_and_a_readme_that_stands_alone(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (info,) = [name for name in names if name.endswith("/METADATA")]
        metadata = email.message_from_bytes(archive.read(info))
        programs = archive.read(info.replace("METADATA", "entry_points.txt")).decode()
    packaged = {"py.typed", "REFERENCE.md", "ARCHITECTURE.md", "schema/robot.schema.json"}
    assert {f"lss_motion/{name}" for name in packaged} <= set(names)
    assert {name.split("/")[0] for name in names} == {"lss_motion", info.split("/")[0]}
    assert metadata["Version"] == lss_motion.__version__
    assert "lss-play = lss_motion.cli.start:play" in programs
    text = metadata.get_payload()
    assert "# lss_motion" in text
    assert "](sequences/" not in text
    assert "](lss_motion/" not in text


def test_the_wheel_has_the_licences_of_its_parts_and_says_what_it_is(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (info,) = [name for name in names if name.endswith("/METADATA")]
        metadata = email.message_from_bytes(archive.read(info))
    assert metadata["License-Expression"] == "MIT AND Apache-2.0"
    folder = info.replace("METADATA", "licenses/")
    assert {name.removeprefix(folder) for name in names if name.startswith(folder)} == {
        "LICENSE",
        "lss_motion/studio/static/vendor/LICENSES.txt",
    }
    assert "Typing :: Typed" in metadata.get_all("Classifier")


def test_what_the_readme_says_of_the_published_package_works_in_an_empty_folder(lss):
    """All but its first line, which needs a package that is published."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (block,) = re.findall(
        r"^```console\n\$ pipx install lss-motion\n(.*?)```", text, re.MULTILINE | re.DOTALL
    )
    commands = [line.removeprefix("$ ").split() for line in block.splitlines()]
    assert [words[0] for words in commands] == ["lss-motion", "lss-play"]
    for words in commands:
        done = lss(*words)
        assert done.returncode == 0, done.stderr


def test_with_a_repository_pictures_and_links_of_the_readme_lead_there():
    text = "![An arm](a/b.png), [guides](g.md), [other](https://example.org/x)"
    assert portable(text, "https://example.org/r") == (
        "![An arm](https://example.org/r/raw/HEAD/a/b.png), "
        "[guides](https://example.org/r/blob/HEAD/g.md), [other](https://example.org/x)"
    )
    assert portable(text, "") == "*An arm.*, guides, [other](https://example.org/x)"


def test_one_address_makes_all_links_of_the_package():
    assert urls("") == {}
    assert set(urls("https://example.org/r")) == {
        "Repository",
        "Documentation",
        "Changelog",
        "Issues",
    }
