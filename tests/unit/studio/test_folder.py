"""What lies in the folder of a show."""

from __future__ import annotations

from lss_motion.studio.folder import joints_of, listed


def test_files_are_listed_by_kind_and_hidden_ones_are_not(tmp_path):
    texts = {
        "show.yaml": "# a comment\nsequence: a\nrobot: robots/arm.yaml\n",
        "json.yaml": '{"sequence": "b", "joints": 1}',
        "walk.yml": "gait: walk\n",
        "robots/arm.yaml": "robot: arm\njoints:\n  a: {id: 1}\n",
        "hall.yaml": "stage: hall\n",
        "notes.yaml": "other: 1\n",
        ".show.yaml.unsaved": "sequence: a\n",
        ".hidden/show.yaml": "sequence: a\n",
        "song.OGG": "",
        "a/b/c/deep.yaml": "sequence: deep\n",
        "show.txt": "sequence: no\n",
    }
    for name, text in texts.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    (tmp_path / "gone.yaml").symlink_to(tmp_path / "nowhere")
    assert listed(tmp_path) == {
        "sequences": ["json.yaml", "show.yaml"],
        "gaits": ["walk.yml"],
        "robots": ["robots/arm.yaml"],
        "stages": ["hall.yaml"],
        "sounds": ["song.OGG"],
    }


def test_joints_have_the_range_that_the_file_names():
    value = {
        "defaults": {"range_deg": [-9, 9]},
        "joints": {"a": {"id": 1, "range_deg": [5, 6]}, "b": 2},
    }
    assert joints_of(value) == {"a": [5, 6], "b": [-9, 9]}
    assert joints_of({"joints": {"a": {"id": 1}}}) == {"a": None}
    assert joints_of({"joints": []}) == {}
