"""What the site of the guides has besides them: the reference, and the order of the contents."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mkdocs.structure.files import File

if TYPE_CHECKING:
    from mkdocs.structure.files import Files

ROOT: Final = Path(__file__).resolve().parent.parent
REFERENCE: Final = "REFERENCE.md"
LINK: Final = re.compile(r"^- \[(?P<title>[^\]]+)\]\((?P<page>guides/[^)]+)\)", re.MULTILINE)
IN_REPOSITORY: Final = re.compile(r"\]\((?:\.\./)+(?:lss_motion|sequences)/(?P<page>[^)]*)\)")


def on_config(config: Any, **_: Any) -> Any:  # noqa: ANN401  mkdocs has no types for it
    """Let the pages stand in the order of the contents."""
    contents = (ROOT / "sequences" / "README.md").read_text(encoding="utf-8")
    pages = [{match["title"]: match["page"]} for match in LINK.finditer(contents)]
    config["nav"] = [{"Guides": "README.md"}, *pages, {"Reference": REFERENCE}]
    return config


def on_files(files: Files, config: Any, **_: Any) -> Files:  # noqa: ANN401
    """Add the reference, which lies in the package."""
    text = (ROOT / "lss_motion" / REFERENCE).read_text(encoding="utf-8")
    files.append(File.generated(config, REFERENCE, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:  # noqa: ANN401
    """Let links to the reference, and from it, lead to pages of the site."""
    up = "../" * page.file.src_uri.count("/")
    return IN_REPOSITORY.sub(lambda match: f"]({up}{match['page']})", markdown)
