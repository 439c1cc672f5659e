"""Updates the parameter tables of the documentation from the declarations.

A page holds `<!-- parameters: package.module:Model -->` ... `<!-- end of parameters -->`; the lines between are
generated. `python -m fringedic_ros.parameter_docs docs/nodes/*.md` rewrites them.
"""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path

from fringedic_ros.parameters import parameter_table

_BLOCK = re.compile(r"(<!-- parameters: ([\w.]+):(\w+) -->\n).*?(<!-- end of parameters -->)", re.DOTALL)


def documented(page: str) -> str:
    """Return a page's text with every parameter table as the named model declares it."""

    def block(match: re.Match[str]) -> str:
        model = getattr(importlib.import_module(match[2]), match[3])
        return f"{match[1]}\n{parameter_table(model)}\n\n{match[4]}"

    return _BLOCK.sub(block, page)


def main() -> None:
    """Rewrite the pages of the command line."""
    for path in map(Path, sys.argv[1:]):
        path.write_text(documented(path.read_text()))


if __name__ == "__main__":
    main()
