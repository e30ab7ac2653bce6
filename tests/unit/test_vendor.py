"""The libraries of the pages are those that `tools/vendor.py` built, unchanged."""

from __future__ import annotations

import re
import shutil

import vendor


def test_every_file_has_the_hash_that_is_kept_beside_it():
    assert vendor.differences(vendor.FOLDER) == []


def test_a_changed_a_missing_and_a_new_file_are_named(tmp_path):
    folder = shutil.copytree(vendor.FOLDER, tmp_path / "vendor")
    with (folder / "preact.js").open("a", encoding="utf-8") as file:
        file.write("\n")
    (folder / "three.js").unlink()
    (folder / "other.js").touch()
    assert vendor.differences(folder) == [
        "other.js: not in vendor.json",
        "three.js: missing",
        "preact.js: differs from its SHA-256",
    ]


def test_every_package_has_its_licence_and_every_bundle_its_names():
    licences = (vendor.FOLDER / vendor.LICENSES).read_text(encoding="utf-8")
    for name, (version, license_name) in vendor.PACKAGES.items():
        assert f"{name} {version}, {license_name}\n" in licences
    for name, modules in vendor.BUNDLES.items():
        declared = (vendor.FOLDER / f"{name}.d.ts").read_text(encoding="utf-8")
        wanted = " ".join(modules.values()).split()
        for export in wanted:
            assert re.search(rf"\b{export}\b", declared), f"{name}: {export}"


def test_a_bundle_imports_nothing():
    """A bare name or an address would need a map or leave the origin."""
    for path in vendor.FOLDER.glob("*.js"):
        text = path.read_text(encoding="utf-8")
        sources = re.findall(r"^import\b[^;]*?from\"([^\"]+)\"", text, re.MULTILINE)
        assert not sources, path.name
        assert not re.search(r"\bnew Function\(|\beval\(", text), "forbidden by the CSP"
