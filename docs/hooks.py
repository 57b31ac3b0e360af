"""Hooks of the site: pictures and the changelog stand once in the repository, outside docs/.

A page writes `../paper_figs/bench.png` as seen from its own file, so that it reads right in the
repository too; the site holds the picture at `paper_figs/bench.png`.
"""

import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parent.parent
PAGES = {"changelog.md": "CHANGELOG.md"}  # page of the site: file of the repository


def on_files(files, config):
    """The files that the site takes from outside docs/."""
    for picture in sorted((ROOT / "paper_figs").glob("*.png")):
        name = f"paper_figs/{picture.name}"
        files.append(File.generated(config, name, abs_src_path=str(picture)))
    for name, source in PAGES.items():
        files.append(File.generated(config, name, abs_src_path=str(ROOT / source)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Links out of docs/ to pictures become links within the site."""
    return re.sub(r"\]\(\.\./((?:\.\./)*paper_figs/[^)\s]+\.png)\)", r"](\1)", markdown)
