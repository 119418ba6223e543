"""Hook of the site: links to files of the project that are no pages become plain text."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)")


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Markdown of a page without links that lead out of docs/; a target has to exist."""
    docs = Path(config["docs_dir"])
    folder = (docs / page.file.src_uri).parent

    def keep(link: re.Match[str]) -> str:
        path = link[2].partition("#")[0]
        if "://" in path or not path:
            return link[0]
        target = (folder / path).resolve()
        # A missing one stays as it is, so that the build tells of it.
        return link[1] if target.exists() and not target.is_relative_to(docs) else link[0]

    return LINK.sub(keep, markdown)
