"""Commands that compute nothing import nothing that computes: it takes seconds of processor time."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

COMPUTING = ("pandas", "numba", "scipy", "xarray", "zarr", "matplotlib")
MAIN = "import fringedic.command.main"
INIT = "import fringedic.configuration.new_rig"
STATUS = """
from fringedic.campaign import CampaignStore, read_plan, status_of
from fringedic.campaign.sentences import status_sentences
from fringedic.campaign.settings import store_address
"""


@pytest.mark.parametrize("code", [MAIN, INIT, STATUS], ids=["command", "init", "campaign status"])
def test_nothing_that_computes_is_imported(code: str) -> None:
    names = f"import json, sys; print(json.dumps(sorted(set(sys.modules) & set({COMPUTING}))))"
    done = subprocess.run([sys.executable, "-c", f"{code}\n{names}"], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == []
