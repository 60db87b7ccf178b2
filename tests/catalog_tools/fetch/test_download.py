"""Downloads against a local web server: cut, killed, misled, and still the same bytes."""

from __future__ import annotations

import hashlib
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import pytest
from archive_server import ArchiveServer, md5sum_text, small_archive

from catalog_tools.errors import BadInput, Damaged, Incomplete
from catalog_tools.fetch import remote
from catalog_tools.fetch.download import sizes_of
from catalog_tools.fetch.fetch import fetch
from catalog_tools.fetch.fetched import COVERAGE_NAME, FORMAT, stated_coverage
from catalog_tools.fetch.layout import RELEASES
from catalog_tools.fetch.ledger import folder_for
from catalog_tools.fetch.patience import Patience, Unavailable
from catalog_tools.fetch.remote import _validator, retry_after_s
from tests.slow import slow


def bring(archive, folder, patience, **options):
    options = {"everything": True, "base_url": archive.base_url} | options
    return fetch("gaia-dr2", folder, patience=patience, **options)


def visible(folder: Path) -> dict[str, bytes]:
    names = [p for p in folder.iterdir() if p.is_file() and p.name != "MD5SUM.txt"]
    return {path.name: path.read_bytes() for path in names}


def test_files_come_verified_and_only_once(archive, tmp_path, hasty):
    seen = []
    report = bring(archive, tmp_path, hasty, progress=lambda *tick: seen.append(tick))
    assert visible(tmp_path) == archive.files
    assert (tmp_path / "MD5SUM.txt").read_text() == archive.md5sum
    size = sum(map(len, archive.files.values()))
    assert (report.downloaded, report.bytes_downloaded) == (5, size)
    assert seen[0] == ("download", 0, size)
    assert seen[-1] == ("download", size, size)
    assert report.notes == ("the list names 5 files; Gaia DR2 has 61234",)
    again = bring(archive, tmp_path, hasty)
    assert (again.downloaded, again.present, again.bytes_present) == (0, 5, size)
    assert archive.sent() == size
    assert all(len(archive.gets(name)) == 1 for name in archive.files)
    assert not list((tmp_path / ".fetch" / "parts").iterdir())


def test_the_folder_says_what_its_files_cover(archive, tmp_path, hasty):
    """By the order-12 pixels of their names, 0 to 10**8 without a gap, in pixels of order 9."""
    bring(archive, tmp_path, hasty)
    paths = [tmp_path / name for name in archive.files]
    coverage, notes = stated_coverage(paths)
    assert coverage is not None
    assert coverage.ranges.tolist() == [[0, 10**8 // 64 + 1]]
    assert notes == ()
    assert stated_coverage(paths[1:])[0] is None
    assert stated_coverage([*paths, tmp_path / "own.csv"])[0] is None


def test_a_whole_release_covers_the_whole_sky(archive, tmp_path, hasty, monkeypatch):
    monkeypatch.setitem(RELEASES, "gaia-dr2", replace(RELEASES["gaia-dr2"], files=5))
    bring(archive, tmp_path, hasty)
    coverage, _ = stated_coverage([tmp_path / name for name in archive.files])
    assert (coverage.source, coverage.sky_fraction) == ("the whole of Gaia DR2", 1.0)


def test_what_another_program_says_of_coverage_is_not_taken(archive, tmp_path, hasty):
    bring(archive, tmp_path, hasty)
    paths, place = [tmp_path / name for name in archive.files], tmp_path / COVERAGE_NAME
    place.write_text(place.read_text().replace(FORMAT, "another/1"))
    assert stated_coverage(paths) == (None, ())
    place.write_text("[" * 100_000)
    assert stated_coverage(paths) == (None, ())
    bring(archive, tmp_path, hasty)
    assert stated_coverage(paths)[0] is not None


def test_connections_cut_at_random_bytes(archive, tmp_path, hasty):
    rng, cuts = random.Random(5), []

    def cut(name: str, start: int) -> int | None:
        if name == "MD5SUM.txt" or sum(cuts) > 150_000:
            return None
        cuts.append(rng.randrange(0, 9_000))
        return cuts[-1]

    archive.does.cut = cut
    bring(archive, tmp_path, hasty, connections=3)
    assert len(cuts) >= 20
    assert visible(tmp_path) == archive.files
    assert archive.sent() == sum(map(len, archive.files.values()))  # no byte was sent twice


def test_cut_body_of_unknown_length_is_found_by_its_digest(archive, tmp_path, hasty):
    archive.does.lengths = False
    name = min(archive.files)
    pending = [5_000]
    archive.does.cut = lambda n, s: pending.pop() if n == name and pending else None
    bring(archive, tmp_path, hasty, connections=1)
    assert visible(tmp_path) == archive.files


SCRIPT = """
import signal, sys
from catalog_tools.fetch.download import sizes_of
from catalog_tools.fetch.fetch import fetch
from catalog_tools.fetch.patience import Patience
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
fetch("gaia-dr2", sys.argv[2], everything=True, base_url=sys.argv[1], connections=2,
      patience=Patience(first_delay_s=0.01))
"""


def in_a_process(archive, folder) -> subprocess.Popen:
    command = [sys.executable, "-c", SCRIPT, archive.base_url, str(folder)]
    root = Path(__file__).resolve().parents[3]
    return subprocess.Popen(command, cwd=root, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("how", [signal.SIGKILL, slow(signal.SIGINT)])
def test_a_killed_process_is_resumed(archive, tmp_path, hasty, how):
    archive.does.block_s = 0.1  # what is left after the last share outlasts the signal's way
    for share in (0.2, 0.5, 0.7):
        process = in_a_process(archive, tmp_path)
        while process.poll() is None and archive.sent() < share * 250_000:
            time.sleep(0.01)
        process.send_signal(how)
        _, said = process.communicate(timeout=20)
        assert process.returncode == -how, said
        for name, data in visible(tmp_path).items():
            assert data == archive.files[name]
    archive.does.block_s = 0.0
    parts = (tmp_path / ".fetch" / "parts").glob("*.part")
    on_disk = sum(map(len, visible(tmp_path).values())) + sum(p.stat().st_size for p in parts)
    report = bring(archive, tmp_path, hasty)
    assert visible(tmp_path) == archive.files
    assert on_disk > 50_000
    assert report.bytes_downloaded == sum(map(len, archive.files.values())) - on_disk


def test_wrong_checksum_once_is_mended(archive, tmp_path, hasty):
    name = min(archive.files)
    good = archive.files[name]
    archive.files[name] = good[:-1] + b"?"
    archive.does.etags[name] = '"same"'
    served = []

    def mend(n: str, start: int) -> None:
        if n == name:
            served.append(start)
            archive.files[name] = good  # from the next request on

    archive.does.cut = mend
    bring(archive, tmp_path, hasty)
    assert served == [0, 0]
    assert visible(tmp_path)[name] == good


def test_wrong_checksum_always_is_damaged_and_others_come(archive, tmp_path, hasty):
    name = min(archive.files)
    archive.files[name] = b"x" * 1000
    with pytest.raises(Damaged, match=name) as caught:
        bring(archive, tmp_path, hasty)
    assert hashlib.md5(b"x" * 1000).hexdigest() in str(caught.value)
    assert len(archive.gets(name)) == 2
    assert visible(tmp_path) == {n: d for n, d in archive.files.items() if n != name}
    assert not list((tmp_path / ".fetch" / "parts").glob("*.part"))


def test_server_without_ranges_starts_over(archive, tmp_path, hasty):
    archive.does.ranges = False
    pending = {name: [500, 20_000, 3_000] for name in archive.files}
    archive.does.cut = lambda name, start: pending[name].pop() if pending.get(name) else None
    bring(archive, tmp_path, hasty)
    assert visible(tmp_path) == archive.files


def test_server_without_ranges_that_always_cuts_is_given_up(archive, tmp_path, hasty):
    archive.does.ranges = False
    archive.does.cut = lambda name, start: None if name == "MD5SUM.txt" else 7_000
    with pytest.raises(Incomplete, match="7000 bytes read"):
        bring(archive, tmp_path, hasty, connections=1)
    assert len(archive.requests) < 20


@pytest.mark.parametrize("honest", [True, False])
def test_changed_file_starts_over(archive, tmp_path, hasty, honest):
    """The file changes between two runs; the server may or may not look at If-Range."""
    name = min(archive.files)
    archive.does.cut = lambda n, start: 9_000 if n == name else None
    with pytest.raises(Incomplete):
        bring(archive, tmp_path, Patience(tries=1))
    new = archive.files[name][::-1]
    archive.files[name] = new
    archive.md5sum = md5sum_text(archive.files)
    archive.does.cut = lambda n, start: None
    if not honest:
        handler = archive._http.RequestHandlerClass
        handler._start = lambda self, request, etag: int((request.range or "bytes=0-")[6:-1])
    parts = [p for p in tmp_path.glob(".fetch/parts/*.part") if not p.name.startswith(name)]
    here = sum(map(len, visible(tmp_path).values())) + sum(p.stat().st_size for p in parts)
    report = bring(archive, tmp_path, hasty)
    assert report.bytes_downloaded == sum(map(len, archive.files.values())) - here  # none twice
    assert visible(tmp_path)[name] == new
    resumed = [r for r in archive.gets(name) if r.range]
    assert (resumed[0].range, resumed[0].if_range is None) == ("bytes=9000-", False)


def test_complete_part_is_not_asked_for_again(archive, tmp_path, hasty):
    """Killed between the last byte and the rename; also without a known length (416)."""
    name = min(archive.files)
    with folder_for(tmp_path, RELEASES["gaia-dr2"]) as ledger:
        part = ledger.part(name)
        part.write_bytes(archive.files[name])
        origin = part.with_name(part.name + ".json")
        origin.write_text('{"tag": null, "total": null}')
    report = bring(archive, tmp_path, hasty)
    assert [r.sent for r in archive.gets(name)] == [0]
    assert report.bytes_downloaded == archive.sent()
    assert visible(tmp_path) == archive.files


@pytest.mark.parametrize("junk", [b"longer than the file", b"y"])
def test_part_of_something_else_goes(archive, tmp_path, hasty, junk):
    name = min(archive.files)
    junk *= 100_000 // len(junk)
    with folder_for(tmp_path, RELEASES["gaia-dr2"]) as ledger:
        part = ledger.part(name)
        part.write_bytes(junk)
        part.with_name(part.name + ".json").write_text('{"tag": null, "total": null}')
        other = ledger.part(max(archive.files))
        other.write_bytes(b"no record of where it is from")
    bring(archive, tmp_path, hasty)
    assert visible(tmp_path) == archive.files


@pytest.mark.parametrize("record", ["", '{"tag": null', "{}", "[7]", "7"])
def test_part_with_a_damaged_record_goes(archive, tmp_path, hasty, record):
    name = min(archive.files)
    with folder_for(tmp_path, RELEASES["gaia-dr2"]) as ledger:
        part = ledger.part(name)
        part.write_bytes(archive.files[name][:9000])
        part.with_name(part.name + ".json").write_text(record)
    bring(archive, tmp_path, hasty)
    assert [r.range for r in archive.gets(name)] == [None]
    assert visible(tmp_path) == archive.files


def test_content_encoding_is_not_decoded(archive, tmp_path, hasty):
    """Some servers call a .gz file 'Content-Encoding: gzip'; what is stored are its bytes."""
    archive.does.content_encoding = "x-gzip"
    bring(archive, tmp_path, hasty)
    assert visible(tmp_path) == archive.files


def test_slow_first_byte_is_tried_again(archive, tmp_path, hasty):
    name = min(archive.files)
    archive.does.slow_s[name] = [8.0]
    bring(archive, tmp_path, replace(hasty, silence_s=0.5, tries=20))
    assert visible(tmp_path) == archive.files
    assert len(archive.gets(name)) >= 2


def test_busy_server_is_obeyed(archive, tmp_path, hasty):
    name = min(archive.files)
    archive.does.first[name] = [(503, {"Retry-After": "1"}), (429, {}), (500, {})]
    began = time.monotonic()
    bring(archive, tmp_path, hasty)
    assert time.monotonic() - began >= 1.0
    assert visible(tmp_path) == archive.files
    assert len(archive.gets(name)) == 4


def test_server_that_asks_for_too_long_a_pause_ends_the_run(archive, tmp_path, hasty):
    archive.does.first[min(archive.files)] = [(503, {"Retry-After": "86400"})]
    with pytest.raises(Incomplete, match="86400 s"):
        bring(archive, tmp_path, hasty)
    bring(archive, tmp_path, hasty)
    assert visible(tmp_path) == archive.files


def test_missing_file_is_named_and_others_come(archive, tmp_path, hasty):
    name = min(archive.files)
    data = archive.files.pop(name)
    with pytest.raises(Incomplete, match=f"{name}: 404 Not Found"):
        bring(archive, tmp_path, hasty)
    assert visible(tmp_path) == archive.files
    archive.files[name] = data
    assert bring(archive, tmp_path, hasty).downloaded == 1


def test_a_pause_ends_where_another_file_ends_the_run(archive, tmp_path, hasty):
    """One file is to be asked for in half a minute, another not any more: the first is not."""
    waits, fails = sorted(archive.files)[:2]
    archive.files = {name: archive.files[name] for name in (waits, fails)}
    archive.md5sum = md5sum_text(archive.files)
    archive.does.first[waits] = [(503, {"Retry-After": "30"})]
    archive.does.first[fails] = [(503, {"Retry-After": "86400"})]
    with pytest.raises(Incomplete, match=f"{fails}: the server asks to come back in 86400 s"):
        bring(archive, tmp_path, hasty, connections=2)
    assert len(archive.gets(waits)) <= 1


def test_redirects_in_a_circle_are_followed_a_few_times(archive, tmp_path, hasty):
    name = min(archive.files)
    archive.does.first[name] = [(302, {"Location": archive.base_url + name})] * 20
    with pytest.raises(Incomplete, match=f"{name}: Exceeded 5 redirects"):
        bring(archive, tmp_path, hasty)
    assert len(archive.gets(name)) == 6


def test_a_server_that_cannot_prove_itself_is_not_asked_again(archive, tmp_path, hasty):
    """Here one that does not encrypt at all, by an address that says so."""
    url = archive.base_url.replace("http:", "https:")
    with pytest.raises(BadInput, match=r"base_url: .* the address of a folder that holds"):
        fetch("gaia-dr2", tmp_path, everything=True, base_url=url, patience=hasty)


def test_a_part_that_does_not_say_which_it_is_is_not_taken(archive, tmp_path, hasty):
    name = min(archive.files)
    archive.does.first[name] = [(206, {})]
    with pytest.raises(Incomplete, match=f"{name}: 206 Partial Content that does not say which"):
        bring(archive, tmp_path, hasty)
    assert name not in visible(tmp_path)


def test_redirects_go_to_http_only(archive, tmp_path, hasty):
    name = min(archive.files)
    with ArchiveServer(archive.files) as mirror:
        archive.does.first[name] = [(302, {"Location": mirror.base_url + name})]
        bring(archive, tmp_path / "a", hasty)
        assert visible(tmp_path / "a") == archive.files
        assert len(mirror.gets(name)) == 1
    for bad in ("file:///etc/passwd", "ftp://127.0.0.1/x"):
        archive.does.first[name] = [(302, {"Location": bad})]
        with pytest.raises(Incomplete, match=name):
            bring(archive, tmp_path / "b", hasty)
        assert not (tmp_path / "b" / name).exists()


def test_ledger_spares_hashing_and_verify_hashes(archive, tmp_path, hasty):
    bring(archive, tmp_path, hasty)
    name = min(archive.files)
    path = tmp_path / name
    state, bad = path.stat(), b"!" + archive.files[name][1:]
    path.write_bytes(bad)
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))  # decay that no date tells
    assert bring(archive, tmp_path, hasty).downloaded == 0
    assert path.read_bytes() == bad
    seen = []
    report = bring(archive, tmp_path, hasty, verify=True, progress=lambda *t: seen.append(t))
    assert (report.downloaded, report.present) == (1, 4)
    assert {stage for stage, *_ in seen} == {"verify", "download"}
    assert visible(tmp_path) == archive.files
    state = path.stat()
    path.write_bytes(bad + b"!")  # another length is seen without being asked, the date as it was
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert bring(archive, tmp_path, hasty).downloaded == 1
    path.write_bytes(bad)  # and so is a new date
    assert bring(archive, tmp_path, hasty).downloaded == 1
    path.write_bytes(archive.files[name])
    for stages in ({"verify", "download"}, {"download"}):  # whoever mended it: hashed once
        seen.clear()
        bring(archive, tmp_path, hasty, progress=lambda *t: seen.append(t))
        assert {stage for stage, *_ in seen} == stages
    with (tmp_path / ".fetch" / "verified.jsonl").open("ab") as file:
        file.write(b'{"name": "torn \xff')
    (tmp_path / max(archive.files)).touch()
    assert bring(archive, tmp_path, hasty).downloaded == 0  # hashed again, noted again
    assert visible(tmp_path) == archive.files


def test_what_the_archive_has_made_anew_comes_anew(archive, tmp_path, hasty):
    """By its digest in the list: its length and the file here are as they were."""
    bring(archive, tmp_path, hasty)
    name = min(archive.files)
    archive.files[name] = b"!" + archive.files[name][1:]
    archive.md5sum = md5sum_text(archive.files)
    assert bring(archive, tmp_path, hasty).downloaded == 1
    assert visible(tmp_path) == archive.files


def test_two_fetches_refuse_each_other(archive, tmp_path, hasty):
    with (
        folder_for(tmp_path, RELEASES["gaia-dr2"]),
        pytest.raises(BadInput, match="no other fetch"),
    ):
        bring(archive, tmp_path, hasty)
    bring(archive, tmp_path, hasty)
    with pytest.raises(BadInput, match="gaia-dr2 files"):
        fetch("gaia-dr3", tmp_path, everything=True, base_url=archive.base_url, patience=hasty)


def test_disk_too_small_is_told_before(archive, tmp_path, hasty, monkeypatch):
    from catalog_tools.fetch import download

    usage = type("Usage", (), {"free": 1000})
    monkeypatch.setattr(download.shutil, "disk_usage", lambda path: usage)
    for each in (64, 0):  # sizes asked one by one, or from the index page
        monkeypatch.setattr(download, "ASK_EACH", each)
        with pytest.raises(BadInput, match="bytes free for what is missing") as caught:
            bring(archive, tmp_path, hasty)
        assert str(sum(map(len, archive.files.values()))) in str(caught.value)
    archive.does.index = False
    bring(archive, tmp_path, hasty)  # sizes not known
    assert visible(tmp_path) == archive.files


def test_a_disk_needs_room_for_what_is_missing_only(archive, tmp_path, hasty, monkeypatch):
    from catalog_tools.fetch import download

    bring(archive, tmp_path, hasty)
    name = max(archive.files, key=lambda n: len(archive.files[n]))
    (tmp_path / name).unlink()
    usage = type("Usage", (), {"free": len(archive.files[name])})
    monkeypatch.setattr(download.shutil, "disk_usage", lambda path: usage)
    bring(archive, tmp_path, hasty)
    assert visible(tmp_path) == archive.files


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_disk_full_is_one_message(archive, tmp_path, hasty):
    name = min(archive.files)
    with folder_for(tmp_path, RELEASES["gaia-dr2"]) as ledger:
        part = ledger.part(name)
    archive.does.cut = lambda n, start: 0 if n == name else None
    with pytest.raises(Incomplete):
        bring(archive, tmp_path, Patience(tries=1))
    part.unlink(missing_ok=True)
    part.symlink_to("/dev/full")
    part.with_name(part.name + ".json").write_text('{"tag": null, "total": null}')
    archive.does.cut = lambda n, start: None
    from catalog_tools.fetch import transfer

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(transfer, "begin", lambda part, origin: None)
        with pytest.raises(Incomplete, match="No space left on device; make room"):
            bring(archive, tmp_path, hasty)
    part.unlink()
    bring(archive, tmp_path, hasty)
    assert visible(tmp_path) == archive.files


def test_a_folder_in_a_files_place_is_no_full_disk(archive, tmp_path, hasty):
    """Told as it is; without it the same command brings all."""
    taken = tmp_path / min(archive.files)
    taken.mkdir()
    with pytest.raises(IsADirectoryError):
        bring(archive, tmp_path, hasty)
    taken.rmdir()
    bring(archive, tmp_path, hasty)
    assert visible(tmp_path) == archive.files


def test_folder_as_mirror(tmp_path, hasty):
    """Its list is as long as that of DR2, 61,236 lines in 4 MB."""
    files = small_archive()
    mirror = tmp_path / "a mirror"
    mirror.mkdir()
    for name, data in files.items():
        (mirror / name).write_bytes(data)
    (mirror / "MD5SUM.txt").write_text(md5sum_text(files) * 8748)
    report = fetch(
        "gaia-dr2", tmp_path / "to", everything=True, base_url=mirror.as_uri(), patience=hasty
    )
    assert visible(tmp_path / "to") == files
    assert report.bytes_downloaded == sum(map(len, files.values()))


def mirror_of(files, folder):
    """The files with their list in a folder; returns its address."""
    folder.mkdir()
    for name, data in {**files, "MD5SUM.txt": md5sum_text(files).encode()}.items():
        (folder / name).write_bytes(data)
    return folder.as_uri()


@pytest.mark.parametrize(("more", "said"), [
    (9, "the connection ended after {} of {} bytes"),
    (-9, "the file changed while it was downloaded"),
])  # fmt: skip
def test_files_of_a_mirror_that_change_meanwhile(tmp_path, hasty, monkeypatch, more, said):
    """One that shrinks, and one that grows, while they are read: left for another run."""
    files = small_archive()
    url, name = mirror_of(files, tmp_path / "mirror"), min(files)
    size = len(files[name])

    def fstat(number):
        found = os.fstat(number)
        other = SimpleNamespace(st_size=size + more, st_mtime_ns=found.st_mtime_ns)
        return other if found.st_size == size else found

    options = {"everything": True, "base_url": url, "patience": hasty, "connections": 1}
    with monkeypatch.context() as patch:
        patch.setattr(remote, "os", SimpleNamespace(fstat=fstat))
        with pytest.raises(Incomplete, match=f"{name}: {said.format(size, size + more)}"):
            fetch("gaia-dr2", tmp_path / "to", **options)
    fetch("gaia-dr2", tmp_path / "to", **options)
    assert visible(tmp_path / "to") == files


def test_a_list_of_a_mirror_that_shrinks_while_it_is_read(tmp_path, hasty, monkeypatch):
    url = mirror_of(small_archive(), tmp_path / "mirror")
    size = (tmp_path / "mirror" / "MD5SUM.txt").stat().st_size
    longer = SimpleNamespace(st_size=size + 9, st_mtime_ns=0)
    monkeypatch.setattr(remote, "os", SimpleNamespace(fstat=lambda _: longer))
    with pytest.raises(Incomplete, match=f"connection ended after {size} of {size + 9} bytes"):
        fetch("gaia-dr2", tmp_path / "to", everything=True, base_url=url, patience=hasty)


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="no file that opens but fails")
def test_a_mirror_whose_disk_fails_is_asked_again_and_given_up(tmp_path, hasty):
    url = mirror_of(small_archive(), tmp_path / "mirror")
    (tmp_path / "mirror" / "MD5SUM.txt").unlink()
    (tmp_path / "mirror" / "MD5SUM.txt").symlink_to("/proc/self/mem")
    with pytest.raises(Incomplete, match=r"MD5SUM\.txt: Input/output error \(3 tries in a row\)"):
        fetch("gaia-dr2", tmp_path / "to", everything=True, base_url=url, patience=hasty)


@pytest.mark.parametrize(
    ("form", "hours"),
    [
        ("%a, %d %b %Y %H:%M:%S GMT", 0), ("%A, %d-%b-%y %H:%M:%S GMT", 0),
        ("%a %b %e %H:%M:%S %Y", 0), ("%a, %d %b %Y %H:%M:%S +0200", 2),
        ("%a, %d %b %Y %H:%M:%S -0500", -5),
    ],
)  # fmt: skip
def test_a_pause_may_be_told_as_a_date(form, hours):
    """All three forms of RFC 9110, 5.6.7, the last without a zone; and other zones."""
    for wait_s in (7200.0, -7200.0):
        then = datetime.now(UTC) + timedelta(seconds=wait_s, hours=hours)
        assert retry_after_s(then.strftime(form)) == pytest.approx(max(0.0, wait_s), abs=60.0)


@pytest.mark.parametrize(
    ("text", "wait_s"), [(None, None), ("", None), ("17", 17.0), (" 0 ", 0.0), ("soon", None)]
)
def test_a_pause_may_be_told_in_seconds_or_not_at_all(text, wait_s):
    assert retry_after_s(text) == wait_s


@pytest.mark.parametrize(
    ("headers", "carried"),
    [
        ({"ETag": '"a"', "Last-Modified": "then"}, '"a"'),
        ({"ETag": 'W/"a"', "Last-Modified": "then"}, "then"),
        ({"ETag": "", "Last-Modified": "then"}, "then"),
        ({"Last-Modified": "then"}, "then"), ({"ETag": 'W/"a"'}, None), ({}, None),
    ],
)  # fmt: skip
def test_a_range_is_asked_for_by_what_tells_every_byte(headers, carried):
    """RFC 9110, 13.1.5: If-Range must not carry a weak tag."""
    assert _validator(SimpleNamespace(headers=headers)) == carried


def test_delays_grow_within_bounds():
    patience = Patience(first_delay_s=0.5, longest_delay_s=60.0)
    for failures in range(1, 2000):
        whole = min(0.5 * 2.0 ** min(failures - 1, 60), 60.0)
        assert 0.5 * whole <= patience.delay_s(failures) <= whole
    import threading

    with pytest.raises(Incomplete, match="8 tries in a row"):
        patience.wait("there", Unavailable("down"), 8, threading.Event())


@pytest.mark.parametrize(("free", "fits"), [(99, False), (100, True), (500, True)])
def test_room_for_what_is_still_missing(tmp_path, monkeypatch, free, fits):
    """Bytes of begun files count as there: 900 of 1000."""
    from catalog_tools.fetch import download

    usage = type("Usage", (), {"free": free})
    monkeypatch.setattr(download.shutil, "disk_usage", lambda path: usage)
    meter = type("Meter", (), {"read": lambda self: (900, 1000)})()
    ledger = type("Ledger", (), {"folder": tmp_path})()
    if fits:
        download._check_space(meter, ledger)
    else:
        with pytest.raises(BadInput, match="100 bytes free for what is missing"):
            download._check_space(meter, ledger)


def test_a_length_that_a_server_does_not_tell_is_unknown():
    """Not nothing: what is left to fetch, and for how long, would be told too short."""
    remote = SimpleNamespace(size={"a": 3}.get)
    assert sizes_of(remote, [SimpleNamespace(name=name) for name in "ab"]) == {"a": 3}
