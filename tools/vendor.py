"""Build the libraries of the studio's pages from pinned npm packages, and check what is there.

tools/run tools/vendor.py           build `lss_motion/studio/static/vendor` again (needs npm)
tools/run tools/vendor.py --check   compare the files there with their SHA-256 (needs nothing)

Users need no Node: the built files are part of the package. A name that a page wants and that is
not in `BUNDLES` is added there.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

FOLDER: Final = (
    Path(__file__).resolve().parent.parent / "lss_motion" / "studio" / "static" / "vendor"
)
BUNDLER: Final = {"esbuild": "0.28.2"}
"""Joins the modules of a package and shortens them; part of no result."""

PACKAGES: Final = {
    "preact": ("11.2.0", "MIT"),
    "htm": ("3.1.1", "Apache-2.0"),
    "@preact/signals": ("2.11.4", "MIT"),
    "@preact/signals-core": ("1.14.5", "MIT"),
    "three": ("0.187.0", "MIT"),
}

BUNDLES: Final = {
    "preact": {
        "preact": "h render Fragment createContext createRef",
        "preact/hooks": "useCallback useEffect useLayoutEffect useMemo useRef useState",
        "htm/preact": "html",
        "@preact/signals": (
            "batch computed effect signal untracked useComputed useSignal useSignalEffect"
        ),
    },
    "three": {
        "three": (
            "AmbientLight ArrowHelper AxesHelper Box3 BoxGeometry BufferAttribute BufferGeometry"
            " CanvasTexture CapsuleGeometry CircleGeometry Color ConeGeometry CylinderGeometry"
            " DirectionalLight DoubleSide EdgesGeometry Euler Float32BufferAttribute GridHelper"
            " Group HemisphereLight Line LineBasicMaterial LineDashedMaterial LineLoop"
            " LineSegments LoadingManager MathUtils Matrix4 Mesh MeshBasicMaterial"
            " MeshLambertMaterial MeshStandardMaterial Object3D PerspectiveCamera Plane"
            " PlaneGeometry Quaternion Raycaster Scene Sphere SphereGeometry Sprite"
            " SpriteMaterial TorusGeometry Vector2 Vector3 WebGLRenderer"
        ),
        "three/examples/jsm/loaders/STLLoader.js": "STLLoader",
    },
}
"""File, then module, then the names that it exports."""

MANIFEST: Final = "vendor.json"
LICENSES: Final = "LICENSES.txt"


def main(words: list[str]) -> int:
    """Build or check; return 1 if a file differs from its hash."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare with the kept SHA-256")
    if parser.parse_args(words).check:
        faults = differences(FOLDER)
        print("\n".join(faults) or f"{FOLDER.name}: as built")
        return 1 if faults else 0
    with tempfile.TemporaryDirectory() as work:
        build(Path(work), FOLDER)
    print(f"{FOLDER}: {sum(path.stat().st_size for path in FOLDER.iterdir()) / 1e3:.0f} kB")
    return 0


def differences(folder: Path) -> list[str]:
    """Return what differs between the files of `folder` and its manifest, as sentences."""
    manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    pinned = {name: version for name, (version, _) in PACKAGES.items()}
    faults = [] if manifest["packages"] == pinned else [f"{MANIFEST}: other versions are pinned"]
    kept = manifest["sha256"]
    there = {path.name: path for path in folder.iterdir() if path.name != MANIFEST}
    faults += [f"{name}: not in {MANIFEST}" for name in sorted(set(there) - set(kept))]
    faults += [f"{name}: missing" for name in sorted(set(kept) - set(there))]
    faults += [
        f"{name}: differs from its SHA-256"
        for name in sorted(set(there) & set(kept))
        if _sha256(there[name]) != kept[name]
    ]
    return faults


def build(work: Path, folder: Path) -> None:
    """Install the packages in `work`, bundle them into `folder`, and write the manifest."""
    (work / "package.json").write_text('{"private": true}', encoding="utf-8")
    pinned = {name: version for name, (version, _) in PACKAGES.items()} | BUNDLER
    names = [f"{name}@{version}" for name, version in pinned.items()]
    _run(work, "npm", "install", "--silent", "--no-audit", "--no-fund", "--save-exact", *names)
    for name, modules in BUNDLES.items():
        lines = [
            f"export {{ {', '.join(exports.split())} }} from '{module}';"
            for module, exports in modules.items()
        ]
        (work / f"{name}.entry.js").write_text("\n".join(lines), encoding="utf-8")
    for path in folder.glob("*"):
        path.unlink()
    folder.mkdir(parents=True, exist_ok=True)
    for name in BUNDLES:
        _bundle(work, folder, name)
    for name, modules in BUNDLES.items():
        (folder / f"{name}.d.ts").write_text(_types(modules), encoding="utf-8")
    (folder / LICENSES).write_text(_licenses(work / "node_modules"), encoding="utf-8")
    manifest = {
        "about": "built by tools/vendor.py; licences in LICENSES.txt",
        "packages": {name: version for name, (version, _) in PACKAGES.items()},
        "sha256": {path.name: _sha256(path) for path in sorted(folder.iterdir())},
    }
    text = json.dumps(manifest, indent=2) + "\n"
    (folder / MANIFEST).write_text(text, encoding="utf-8")


def _bundle(work: Path, folder: Path, name: str) -> None:
    used = sorted({_package(module) for module in BUNDLES[name]})
    parts = ", ".join(f"{own} {PACKAGES[own][0]} ({PACKAGES[own][1]})" for own in used)
    _run(
        work,
        str(work / "node_modules" / ".bin" / "esbuild"),
        "--bundle",
        "--format=esm",
        "--minify",
        "--target=es2022",
        "--legal-comments=none",  # They stand in LICENSES.txt.
        f"--banner:js=/* {parts}; see {LICENSES} */",
        "--log-level=warning",
        f"--outdir={folder}",
        f"{name}={name}.entry.js",
    )


def _types(modules: dict[str, str]) -> str:
    """Return declarations that lead the type checker to those of the packages."""
    lines = [
        f"export {{ {', '.join(exports.split())} }} from '{mod}';"
        for mod, exports in modules.items()
    ]
    return "\n".join(["// Written by tools/vendor.py, for tsc only.", *lines, ""])


def _package(module: str) -> str:
    return "/".join(module.split("/")[: 2 if module.startswith("@") else 1])


def _licenses(modules: Path) -> str:
    """Return the licences of all packages; one without a text of its own gets the common one."""
    apache = (modules / "htm" / "LICENSE").read_text(encoding="utf-8")
    apache = apache[: apache.index("END OF TERMS AND CONDITIONS")].rstrip()
    parts = []
    for name, (version, license_name) in PACKAGES.items():
        about = json.loads((modules / name / "package.json").read_text(encoding="utf-8"))
        assert about["license"] == license_name, f"{name}: licence {about['license']}"
        assert about["version"] == version, f"{name}: version {about['version']}"
        own = modules / name / "LICENSE"
        text = own.read_text(encoding="utf-8") if own.exists() else apache
        parts.append(f"{name} {version}, {license_name}\n{'=' * 40}\n\n{text.strip()}\n")
    return "\n\n".join(parts)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _run(folder: Path, *words: str) -> None:
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"{words[0]}: {done.stdout}{done.stderr}")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
