"""Makes the links of the package and its README from one constant, for the page on an index.

The constant is `repository` in pyproject.toml. An index shows the text of the README alone: with a
repository, pictures and links become absolute addresses there; without one, a picture leaves its
description and a link its words.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

LINK = re.compile(r"(?P<mark>!?)\[(?P<words>[^\]]+)\]\((?P<target>[^)\s]+)\)")


class MetadataHook(MetadataHookInterface):
    """Called by hatchling when it builds, since pyproject.toml names this file."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the links and the README of the package."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        repository = str(self.config["repository"]).rstrip("/")
        metadata["urls"] = urls(repository)
        metadata["readme"] = {"content-type": "text/markdown", "text": portable(text, repository)}


def urls(repository: str) -> dict[str, str]:
    """Return the links of the package; none without a repository."""
    if not repository:
        return {}
    return {
        "Repository": repository,
        "Documentation": f"{repository}/blob/HEAD/sequences/README.md",
        "Changelog": f"{repository}/blob/HEAD/.github/CHANGELOG.md",
        "Issues": f"{repository}/issues",
    }


def portable(text: str, repository: str) -> str:
    """Return Markdown without relative pictures and links."""

    def replaced(match: re.Match[str]) -> str:
        target = match["target"]
        if "://" in target:
            return match[0]
        if not repository:
            return f"*{match['words']}.*" if match["mark"] else match["words"]
        kind = "raw" if match["mark"] else "blob"
        return f"{match['mark']}[{match['words']}]({repository}/{kind}/HEAD/{target})"

    return LINK.sub(replaced, text)
