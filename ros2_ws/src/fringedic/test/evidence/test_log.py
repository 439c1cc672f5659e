"""The log of a run: its key, its entries, what is found in one that was changed, and time stamps."""

from __future__ import annotations

import shutil
import subprocess
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from fringedic.errors import EvidenceError
from fringedic.evidence import add_note, add_time_stamp, because, begin_log, check_time_stamp, noted, read_log
from fringedic.evidence.keys import KEY, PUBLIC, key_folder, laboratory_key, raw_public, read_public_key
from fringedic.evidence.log import LOG, PUBLIC_KEY, SIGNATURE
from fringedic.evidence.time_stamps import read_certificates

needs_openssl = pytest.mark.skipif(shutil.which("openssl") is None, reason="the program openssl is not installed")


@pytest.fixture(autouse=True)
def key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "configuration"))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "plate-7"
    (folder / "bag").mkdir(parents=True)
    (folder / "bag" / "bag_0.mcap").write_bytes(bytes(1000))
    (folder / "results.nc").write_text("1.0")
    begin_log(folder, "run", operator="A. Operator", details={"interrupted": False})
    return folder


def faults(folder: Path) -> tuple[list[str], list[int]]:
    log = read_log(folder)
    return log.faults, log.unsigned


def test_the_key_is_made_once_and_only_its_owner_reads_it() -> None:
    first = raw_public(laboratory_key())
    assert raw_public(laboratory_key()) == first == read_public_key(key_folder() / PUBLIC)
    file = key_folder() / KEY
    assert file.stat().st_mode & 0o777 == 0o600
    file.chmod(0o640)
    with pytest.raises(EvidenceError, match="others can read the key"):
        laboratory_key()


def test_the_first_entry_contains_every_file(run: Path) -> None:
    log = read_log(run)
    assert faults(run) == ([], [])
    assert sorted(log.files) == ["bag/bag_0.mcap", "results.nc"]
    assert log.entries[0].name == "A. Operator"
    with pytest.raises(EvidenceError, match="exists already"):
        begin_log(run, "run", details={})


def test_a_change_has_an_entry_with_its_reason_and_both_digests(run: Path) -> None:
    before = read_log(run).files["results.nc"]
    with because("other window"), noted(run / "results.nc", "process", details={"datasets": {"results.nc": 1}}):
        (run / "results.nc").write_text("2.0")
        with noted(run / "report.html", "page", details={"datasets": {"b.nc": 2}}):  # belongs to the entry of the outer
            pass
    log = read_log(run)
    assert faults(run) == ([], [])
    [_, entry] = log.entries
    assert (entry.action, entry.why, entry.details) == (
        "process",
        "other window",
        {"datasets": {"results.nc": 1, "b.nc": 2}},
    )
    assert entry.files == {"results.nc": (before, log.files["results.nc"])}
    assert before != log.files["results.nc"]


def test_what_a_failed_command_has_changed_is_noted(run: Path) -> None:
    def fail() -> None:
        with noted(run / "results.nc", "process"):
            (run / "results.nc").unlink(missing_ok=True)
            raise InterruptedError

    for _ in range(2):  # the second time nothing changes
        with pytest.raises(InterruptedError):
            fail()
    [_, entry] = read_log(run).entries
    assert entry.files["results.nc"][1] is None


def test_a_run_without_a_log_gets_none(tmp_path: Path) -> None:
    with noted(tmp_path / "results.nc", "process"):
        (tmp_path / "results.nc").write_text("1.0")
    assert not (tmp_path / LOG).exists()


def test_a_later_command_does_not_hide_a_change_before_it(run: Path) -> None:
    (run / "results.nc").write_text("9.9")
    with noted(run / "results.nc", "process"):
        (run / "results.nc").write_text("2.0")
    [fault], unsigned = faults(run)
    assert fault == "before entry 1 something that the log does not name changed results.nc"
    assert not unsigned


def test_a_later_signature_does_not_hide_an_edited_entry(run: Path) -> None:
    text = (run / LOG).read_text()
    (run / LOG).write_text(text.replace("A. Operator", "B. Operator"))
    add_note(run, "nothing special")
    assert faults(run) == ([], [1]), "the signature of the time before entry 1 does not fit"


def test_a_line_that_was_cut_off_is_found_and_the_log_goes_on(run: Path) -> None:
    add_note(run, "a note")
    (run / LOG).write_bytes((run / LOG).read_bytes()[:-30])
    add_note(run, "another")
    found, _ = faults(run)
    assert found == [f"line 2 of {LOG} is damaged, so that it and those after it cannot be read"]


def test_a_removed_last_entry_is_found(run: Path) -> None:
    add_note(run, "the specimen had slipped")
    lines = (run / LOG).read_bytes().splitlines(keepends=True)
    (run / LOG).write_bytes(lines[0])
    assert faults(run) == ([], [1])


def test_a_note_covers_files_that_were_changed_by_hand(run: Path) -> None:
    (run / "photo.png").write_bytes(b"photo")
    (run / "results.nc").unlink()
    add_note(run, "photo added, results removed", [run / "photo.png", run / "results.nc"])
    assert sorted(read_log(run).files) == ["bag/bag_0.mcap", "photo.png"]
    with pytest.raises(EvidenceError, match=r"contains no other.png"):
        add_note(run, "?", [run / "other.png"])
    with pytest.raises(EvidenceError, match="is not in"):
        add_note(run, "?", [run.parent / "other.png"])


@needs_openssl
def test_openssl_verifies_the_signature(run: Path) -> None:
    words = ["pkeyutl", "-verify", "-pubin", "-inkey", PUBLIC_KEY, "-rawin", "-in", LOG, "-sigfile", SIGNATURE]
    assert "Signature Verified Successfully" in openssl(run, *words).decode()


def openssl(folder: Path, *words: str) -> bytes:
    return subprocess.run(["openssl", *words], cwd=folder, capture_output=True, check=True).stdout


AUTHORITY = """
[tsa]
serial = serial
signer_cert = tsa.pem
signer_key = tsa.key
signer_digest = sha256
default_policy = 1.2.3.4
digests = sha256
[extensions]
extendedKeyUsage = critical,timeStamping
"""


@pytest.fixture
def authority(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    """Address and root certificate of a time-stamp authority of openssl."""
    folder = tmp_path / "authority"
    folder.mkdir()
    (folder / "tsa.cnf").write_text(AUTHORITY)
    new = ["-newkey", "rsa:2048", "-nodes"]
    openssl(folder, "req", "-x509", *new, "-keyout", "root.key", "-out", "root.pem", "-subj", "/CN=Root", "-days", "2")
    openssl(folder, "req", *new, "-keyout", "tsa.key", "-out", "tsa.csr", "-subj", "/CN=Authority")
    sign = [
        "-CA",
        "root.pem",
        "-CAkey",
        "root.key",
        "-set_serial",
        "2",
        "-extfile",
        "tsa.cnf",
        "-extensions",
        "extensions",
    ]
    openssl(folder, "x509", "-req", "-in", "tsa.csr", *sign, "-out", "tsa.pem", "-days", "2")

    class Answer(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            (folder / "query").write_bytes(self.rfile.read(int(self.headers["Content-Length"])))
            reply = ["-reply", "-config", "tsa.cnf", "-section", "tsa", "-queryfile", "query", "-out", "reply"]
            openssl(folder, "ts", *reply)
            self.send_response(200)
            self.end_headers()
            self.wfile.write((folder / "reply").read_bytes())

        def log_message(self, *_: object) -> None:
            """Write nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Answer)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}", folder / "root.pem"
    server.shutdown()
    thread.join()
    server.server_close()


@needs_openssl
def test_a_time_stamp_confirms_the_entries_before_it(run: Path, authority: tuple[str, Path]) -> None:
    server, root = authority
    when = add_time_stamp(run, server)
    add_note(run, "later")
    log, roots = read_log(run), read_certificates(root)
    assert faults(run) == ([], [])
    assert check_time_stamp(log.entries[1], log.before(1), roots) == when
    with pytest.raises(EvidenceError, match="is not confirmed"):
        check_time_stamp(log.entries[1], log.before(1) + b" ", roots)
    other = root.with_name("other.pem")
    words = ["-newkey", "rsa:2048", "-nodes", "-keyout", "other.key", "-out", other.name, "-subj", "/CN=Other"]
    openssl(root.parent, "req", "-x509", *words)
    with pytest.raises(EvidenceError, match="is not confirmed"):
        check_time_stamp(log.entries[1], log.before(1), read_certificates(other))


def test_a_server_without_time_stamps_is_named(run: Path) -> None:
    with pytest.raises(EvidenceError, match=r"http://127.0.0.1:9: gives no time stamp"):
        add_time_stamp(run, "http://127.0.0.1:9")
    with pytest.raises(EvidenceError, match="is no address"):
        add_time_stamp(run, "file:///etc/hostname")
    assert len(read_log(run).entries) == 1
