"""The Python code of README and docs runs as it stands, from the top of each page to its end."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CODE = re.compile(r"^```(?:python|\{code-cell\})\n(.*?)^```", re.MULTILINE | re.DOTALL)
PAGES = {path: CODE.findall(path.read_text(encoding="utf-8")) for path in [ROOT / "README.md", *ROOT.glob("docs/*.md")]}


@pytest.mark.parametrize("page", sorted(page for page, cells in PAGES.items() if cells), ids=lambda page: page.stem)
def test_code_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # Files are named as seen from the checkout; what the pages write goes to a folder of its own.
    (tmp_path / "python").symlink_to(ROOT / "python")
    names: dict[str, object] = {}
    for cell in PAGES[page]:
        exec(compile(cell, str(page), "exec"), names)
