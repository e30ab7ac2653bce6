"""Makes the README readable outside of the repository, for the page on a package index.

An index shows the text alone. With a `Repository` under `[project.urls]`, pictures and links become
absolute addresses there; without one, a picture leaves its description and a link its words.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

LINK = re.compile(r"(?P<mark>!?)\[(?P<words>[^\]]+)\]\((?P<target>[^)\s]+)\)")


class ReadmeHook(MetadataHookInterface):
    """Called by hatchling when it builds, since pyproject.toml names this file."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the README of the package."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        repository = metadata.get("urls", {}).get("Repository")
        metadata["readme"] = {"content-type": "text/markdown", "text": portable(text, repository)}


def portable(text: str, repository: str | None) -> str:
    """Return Markdown without relative pictures and links."""

    def replaced(match: re.Match[str]) -> str:
        target = match["target"]
        if "://" in target:
            return match[0]
        if repository is None:
            return f"*{match['words']}.*" if match["mark"] else match["words"]
        kind = "raw" if match["mark"] else "blob"
        return f"{match['mark']}[{match['words']}]({repository.rstrip('/')}/{kind}/HEAD/{target})"

    return LINK.sub(replaced, text)
