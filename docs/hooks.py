"""Hooks of the site, which take pictures and the changelog from outside docs/.

A page links to `../paper_figs/bench.png` relative to its own file, so that the link works in the
repository too; the site has the picture at `paper_figs/bench.png`.
"""

import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parent.parent
PAGES = {"changelog.md": "CHANGELOG.md"}  # page of the site: file of the repository


def on_files(files, config):
    """Add the files that the site takes from outside docs/."""
    sheet = ROOT / "experiments" / "results" / "meeting_colours.png"
    for picture in (*sorted((ROOT / "paper_figs").glob("*.png")), sheet):
        name = picture.relative_to(ROOT).as_posix()
        files.append(File.generated(config, name, abs_src_path=str(picture)))
    for name, source in PAGES.items():
        files.append(File.generated(config, name, abs_src_path=str(ROOT / source)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Turn links out of docs/ to pictures into links within the site."""
    pictures = r"(?:\.\./)*(?:paper_figs|experiments/results)/[^)\s]+\.png"
    return re.sub(rf"\]\(\.\./({pictures})\)", r"](\1)", markdown)
