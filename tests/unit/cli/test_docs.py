"""`docs`: the guides are where the package is, and each can be printed."""

from __future__ import annotations

import webbrowser

from lss_motion.cli import docs
from lss_motion.cli.main import main


def test_a_page_is_printed_and_an_unknown_one_gets_a_suggestion(capsys):
    assert main(["docs", "--list"]) == 0
    names = capsys.readouterr().out.split()
    assert {"first-show", "glossary", "recipes"} <= set(names)
    assert main(["docs", "recipes"]) == 0
    assert capsys.readouterr().out.startswith("# Recipes\n")
    assert main(["docs", "recipe"]) == 2
    assert "did you mean 'recipes'" in capsys.readouterr().err


def test_the_site_is_opened_where_it_was_built(tmp_path, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda url: opened.append(url) or True)
    monkeypatch.setattr(docs, "PACKAGE", tmp_path)
    (tmp_path / "guides").mkdir()
    assert main(["docs"]) == 0
    assert "the guides are in" in capsys.readouterr().out
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "index.html").write_text("<!doctype html>")
    assert main(["docs"]) == 0
    assert opened == [(tmp_path / "site" / "index.html").as_uri()]
