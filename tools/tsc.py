"""Check the types of the studio's pages with `tsc --checkJs --strict` (needs npm; for developers).

tools/run tools/tsc.py

The compiler and the declarations of the libraries are pinned here and in `tools/vendor.py`; they
are installed once, into the user's cache.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING, Final

import platformdirs
import vendor

if TYPE_CHECKING:
    from pathlib import Path

PAGES: Final = vendor.FOLDER.parent
COMPILER: Final = {"typescript": "7.0.2", "@types/three": "0.187.0"}
OPTIONS: Final = {
    "allowJs": True,
    "checkJs": True,
    "strict": True,
    "noEmit": True,
    "target": "es2022",
    "module": "es2022",
    "moduleResolution": "bundler",
    "lib": ["es2023", "dom", "dom.iterable"],
    "types": [],
    "noUnusedLocals": True,
    "noUnusedParameters": True,
    "noImplicitReturns": True,
    "skipLibCheck": True,
}


def main() -> int:
    """Check all modules of the pages; return the exit code of the compiler."""
    if shutil.which("npm") is None:
        print("types of the pages are not checked: npm is not installed")
        return 0
    modules = installed()
    names = {"three": "@types/three", **{name: name for name in vendor.PACKAGES if name != "three"}}
    options = OPTIONS | {
        "paths": {
            **{name: [str(modules / place)] for name, place in names.items()},
            **{f"{name}/*": [str(modules / place / "*")] for name, place in names.items()},
        }
    }
    sources = sorted(str(path) for path in PAGES.rglob("*.js") if path.parent.name != "vendor")
    sources += sorted(str(path) for path in PAGES.glob("*.d.ts"))
    config = modules.parent / "tsconfig.json"
    config.write_text(json.dumps({"compilerOptions": options, "files": sources}), encoding="utf-8")
    return subprocess.run(
        [str(modules / ".bin" / "tsc"), "-p", str(config)], check=False
    ).returncode


def installed() -> Path:
    """Return the folder of the packages, installed there if they are not yet."""
    pinned = {name: version for name, (version, _) in vendor.PACKAGES.items()} | COMPILER
    digest = hashlib.sha256(json.dumps(pinned).encode()).hexdigest()[:12]
    folder = platformdirs.user_cache_path("lss_motion") / f"tsc-{digest}"
    if not (folder / "done").exists():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "package.json").write_text('{"private": true}', encoding="utf-8")
        names = [f"{name}@{version}" for name, version in pinned.items()]
        words = ["npm", "install", "--silent", "--no-audit", "--no-fund", *names]
        subprocess.run(words, cwd=folder, check=True)
        (folder / "done").touch()
    return folder / "node_modules"


if __name__ == "__main__":
    sys.exit(main())
