"""A kept show is the show of its files, or a miss: never an old one, never another's."""

from __future__ import annotations

import json
import os
import pickle
import random
from pathlib import Path

import pytest
from msgspec.structs import replace

from lss_motion.cli import main as program
from lss_motion.cli import play
from lss_motion.files import cache
from lss_motion.planning import kept, show_cache, shows
from lss_motion.planning.program.move_table import table_of
from tests.pair import NOD, ROBOT

EXAMPLES = Path(__file__).parents[2] / "sequences"

TWICE = """
sequence: twice
robot: robot.yaml
play:
  - {file: nod.yaml, times: 2}
sound: bell.wav
"""
CALLS = "events:\n  - {at_s: 1, run: 'effects:light'}\n"


class Maker:
    """Makes the show of a file, and counts how often."""

    def __init__(self, path):
        self.path, self.count = path, 0

    def __call__(self):
        self.count += 1
        return shows.prepare(self.path, None)

    def cached(self):
        return show_cache.cached((str(self.path),), self)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.DIRECTORY_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.setenv("LSS_MOTION_STATE_DIR", str(tmp_path / "state"))
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "nod.yaml").write_text(NOD)
    (tmp_path / "twice.yaml").write_text(TWICE)
    (tmp_path / "bell.wav").write_bytes(b"")
    return tmp_path


@pytest.fixture
def nod(folder):
    maker = Maker(folder / "nod.yaml")
    maker.cached()
    return maker


def entry():
    (path,) = cache.cache_directory().glob(f"*{cache.SHOW_SUFFIX}")
    return path


def seal(content):
    """Write an entry as the program does, with a mark that is right."""
    path = entry()
    name = path.name.removesuffix(cache.SHOW_SUFFIX).encode()
    mark = cache.mark_of([name, *kept.versions(), content])
    path.write_bytes(mark + content)


def states_and_show():
    return pickle.loads(entry().read_bytes()[cache.MARK_BYTES :])


def test_a_kept_show_is_the_show_that_was_made(folder):
    maker = Maker(folder / "twice.yaml")
    made, kept = maker.cached(), maker.cached()
    assert maker.count == 1
    assert kept.program.to_text() == made.program.to_text()
    assert (kept.robot, kept.sequence) == (made.robot, made.sequence)
    assert repr(kept.trajectory) == repr(made.trajectory)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("twice.yaml", "times: 2", "times: 3"),
        ("nod.yaml", "tilt: 30", "tilt: 20"),
        ("robot.yaml", "[-90, 90]", "[-80, 80]"),
    ],
)
def test_a_changed_file_makes_the_show_again(name, old, new, folder):
    maker = Maker(folder / "twice.yaml")
    before = maker.cached()
    path = folder / name
    path.write_text(path.read_text().replace(old, new))
    again = maker.cached()
    assert (again.robot, again.sequence) != (before.robot, before.sequence)
    maker.cached()
    assert maker.count == 2


def test_a_sound_that_is_gone_is_reported_although_the_show_is_kept(folder):
    maker = Maker(folder / "twice.yaml")
    maker.cached()
    (folder / "bell.wav").unlink()
    with pytest.raises(shows.InputError, match=r"sound file 'bell\.wav' not found"):
        maker.cached()


def test_other_words_of_the_command_line_are_another_show(nod):
    show_cache.cached((str(nod.path), 0.5), nod)
    assert nod.count == 2


def test_another_folder_is_another_show(nod, folder, monkeypatch):
    (folder / "below").mkdir()
    monkeypatch.chdir(folder / "below")
    nod.cached()
    assert nod.count == 2


def test_another_version_of_the_program_is_a_miss(nod, folder, monkeypatch):
    package = folder / "package"
    planner = package / "planning" / "trajectory" / "planner.py"
    planner.parent.mkdir(parents=True)
    planner.write_text("A = 1\n")
    monkeypatch.setattr(kept, "__file__", str(package / "planning/kept.py"))
    for count in (2, 2):
        kept.versions.cache_clear()
        nod.cached()
        assert nod.count == count
    planner.write_text("A = 12\n")
    kept.versions.cache_clear()
    nod.cached()
    assert nod.count == 3
    monkeypatch.undo()
    kept.versions.cache_clear()


def test_damage_anywhere_is_a_miss(nod):
    whole, generator = entry().read_bytes(), random.Random(3)
    for count in range(2, 22):
        damaged = bytearray(whole)
        damaged[generator.randrange(len(whole))] ^= 1 << generator.randrange(8)
        entry().write_bytes(damaged if count > 4 else whole[: (count - 2) * 20])
        nod.cached()
        assert nod.count == count
        assert entry().read_bytes() == whole


def test_an_entry_under_another_name_is_a_miss(nod, folder):
    whole = entry().read_bytes()
    entry().unlink()
    (folder / "other.yaml").write_text(NOD.replace("40", "20"))
    other = Maker(folder / "other.yaml")
    other.cached()
    entry().write_bytes(whole)
    assert other.cached().program.name == "nod"
    assert other.count == 2


def test_an_entry_of_another_user_is_a_miss(nod, folder):
    (folder / "state" / cache.KEY_NAME).unlink()
    nod.cached()
    assert nod.count == 2
    nod.cached()
    assert nod.count == 2


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no permissions of this kind")
def test_a_key_that_others_can_read_proves_nothing(nod, folder):
    key = folder / "state" / cache.KEY_NAME
    before = key.read_bytes()
    assert key.stat().st_mode & 0o077 == 0
    key.chmod(0o644)
    nod.cached()
    assert nod.count == 2
    assert key.read_bytes() != before
    assert key.stat().st_mode & 0o077 == 0


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give a file away"
)
def test_entries_with_a_key_of_another_user_are_misses(nod, folder):
    """Another user has put key and entries where this one looks: a shared or a stolen folder."""
    key = folder / "state" / cache.KEY_NAME
    os.chown(key, 65534, 65534)
    nod.cached()
    assert nod.count == 2
    assert key.stat().st_uid == 0


class ForeignCall:
    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


def test_what_is_sealed_calls_no_function(nod, folder):
    for call in (
        ForeignCall(os.mkdir, str(folder / "made")),
        ForeignCall(shows.prepare, folder / "nod.yaml", None),
        ForeignCall(eval, "1"),
    ):
        states, _ = states_and_show()
        before = nod.count
        seal(pickle.dumps((states, call), kept.PROTOCOL))
        nod.cached()
        assert nod.count == before + 1
    assert not (folder / "made").exists()


@pytest.mark.parametrize("content", [b"", b"\x80\x05.", b"N.N.", b"]." * 2, b"}.N.", b"}.}."])
def test_sealed_nonsense_is_a_miss(content, nod):
    seal(content)
    assert nod.cached().program.name == "nod"
    assert nod.count == 2


def test_a_sealed_program_that_breaks_a_limit_is_a_miss(nod):
    states, show = states_and_show()
    further = [move._replace(target_wire=5 * move.target_wire) for move in show.program.moves]
    show = replace(show, program=replace(show.program, moves=table_of(further)))
    seal(pickle.dumps((states, show), kept.PROTOCOL))
    assert list(nod.cached().program.moves) != further
    assert nod.count == 2


def test_a_pipe_in_place_of_an_entry_is_a_miss(nod):
    path = entry()
    path.unlink()
    os.mkfifo(path)
    nod.cached()
    assert nod.count == 2


def test_a_cache_or_a_key_that_cannot_be_written_is_no_error(folder, monkeypatch):
    (folder / "file").write_text("")
    maker = Maker(folder / "nod.yaml")
    for variable in (cache.DIRECTORY_VARIABLE, "LSS_MOTION_STATE_DIR"):
        with monkeypatch.context() as changed:
            changed.setenv(variable, str(folder / "file" / "below"))
            assert maker.cached().program.name == "nod"
    assert not list(cache.cache_directory().glob(f"*{cache.SHOW_SUFFIX}"))


def test_a_full_disk_leaves_no_part_of_an_entry(folder, monkeypatch):
    def replace_nothing(*_):
        raise OSError(28, "No space left on device")

    maker = Maker(folder / "nod.yaml")
    monkeypatch.setattr(Path, "replace", replace_nothing)
    maker.cached()
    assert not [path for path in folder.rglob("*") if path.name.endswith((".show", "_part"))]


def test_a_show_with_functions_is_not_kept(folder):
    (folder / "effects.py").write_text("def light():\n    pass\n")
    (folder / "nod.yaml").write_text(NOD + CALLS)
    maker = Maker(folder / "nod.yaml")
    maker.cached()
    maker.cached()
    assert maker.count == 2


def test_limits_that_were_asked_of_servos_are_not_kept(folder):
    def make():
        show = shows.prepare(folder / "nod.yaml", None)
        return replace(show, robot=replace(show.robot, read_limits={"pan": {}}))

    show_cache.cached((), make)
    assert not cache.cache_directory().exists()


def test_other_files_in_the_folder_stay(folder, monkeypatch):
    cache.cache_directory().mkdir()
    (cache.cache_directory() / "thesis.txt").write_text("mine")
    monkeypatch.setattr(cache, "BYTES_MAX", 1)
    Maker(folder / "nod.yaml").cached()
    assert [path.name for path in cache.cache_directory().iterdir()] == ["thesis.txt"]


def _outputs(path, folder, capsys, *, is_played):
    """Return all that commands print and write about a show."""
    files = [folder / f"out.{kind}" for kind in ("json", "csv", "log")]
    report, truth, log = map(str, files)
    commands = [
        (program.main, ["check", str(path), "--all"]),
        (program.main, ["check", str(path), "--json"]),
        (play.main, [str(path), "--dry-run", "--all"]),
    ]
    if is_played:
        outputs = ["--report", report, "--truth", truth, "--log", log]
        commands.append((play.main, [str(path), "--virtual", *outputs]))
    texts = []
    for run, words in commands:
        assert run(words) == 0
        texts.append(tuple(capsys.readouterr()))
    return texts, [file.read_bytes() for file in files if is_played]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["twice", "wave", "playlist"])
def test_what_users_see_is_the_same_with_and_without_the_cache(name, folder, capsys, monkeypatch):
    is_played = name == "twice"
    path = (folder if is_played else EXAMPLES) / f"{name}.yaml"
    made = _outputs(path, folder, capsys, is_played=is_played)
    monkeypatch.setattr(shows, "prepare", None)
    assert _outputs(path, folder, capsys, is_played=is_played) == made
    assert not is_played or json.loads(made[1][0])["outcome"] == "finished"
