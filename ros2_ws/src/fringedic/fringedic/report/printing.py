"""Prints a page as PDF by the browser that is installed, with the style sheet of the page for paper."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from fringedic.errors import FringedicError
from fringedic.evidence.changes import noted

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_LONGEST_S = 120
_DRAWING_MS = 10_000  # of the page's own clock, for its charts


def print_page(page: Path, pdf: Path) -> Path:
    """Print a page and return the file.

    Parameters
    ----------
    page
        The HTML file, which needs no other file.
    pdf
        The file to write; an existing one is replaced.

    Raises
    ------
    FringedicError
        No browser is installed, or it does not print the page.
    """
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise FringedicError(
            f"{pdf}: no {' or '.join(BROWSERS[::2])} is installed to print the page; install chromium (Debian: sudo "
            f"apt-get install chromium), or print {page} from any browser"
        )
    command = [browser, "--headless", "--disable-gpu", "--no-pdf-header-footer", f"--virtual-time-budget={_DRAWING_MS}"]
    if os.geteuid() == 0:
        command.append("--no-sandbox")  # the browser refuses to start as root with it; the page is our own
    with tempfile.TemporaryDirectory(prefix="fringedic-print-") as folder:
        printed = Path(folder) / "page.pdf"
        command += [f"--user-data-dir={folder}/profile", f"--print-to-pdf={printed}", page.absolute().as_uri()]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST_S, check=False)
        except subprocess.TimeoutExpired as error:
            raise FringedicError(
                f"{pdf}: {browser} did not print {page} within {_LONGEST_S} s; print the page from a browser"
            ) from error
        if not printed.exists():
            reason = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
            raise FringedicError(f"{pdf}: {browser} did not print {page} ({reason}); print the page from a browser")
        with noted(pdf, "printed page"):
            shutil.copyfile(printed, pdf)
    return pdf
