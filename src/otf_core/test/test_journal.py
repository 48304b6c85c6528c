# SPDX-License-Identifier: Apache-2.0
"""Journal of a run: readable at any moment, whole after a crash, clear when the disk fails."""

import errno
import os
import time
from types import SimpleNamespace

import numpy as np
import pytest
from bag_cells import CONTENT, path_cdr, read_with_anyreader, some_samples
from mcap.reader import make_reader

from otf_core.bags import journal as journal_module
from otf_core.bags.bag import read_bag
from otf_core.bags.cdr import encode_points
from otf_core.bags.journal import (
    Definitions,
    Journal,
    JournalFile,
    Rows,
    state_of,
    unfinished_runs,
)
from otf_core.bags.mcap_messages import McapMessages
from otf_core.bags.rosbag2_metadata import PATH, POINT, STATUS
from otf_core.errors import ConfigError

TEXTS = {STATUS.type: 'string stream_id\n'}
SAMPLES = some_samples(400)


@pytest.fixture
def journal(tmp_path):
    made = Journal(tmp_path / 'journal', TEXTS)
    yield made
    if made._thread.is_alive():
        made.close()


def put(journal, start=0, stop=400, frame='tracker'):
    rows = slice(start, stop)
    journal.points(SAMPLES.stamp_ns[rows], SAMPLES.xyz[rows], frame)


def wait(condition):
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def readable(folder, count):
    """Tell whether a run can be read and holds so many samples."""
    return (folder / 'metadata.yaml').exists() and len(read_bag(folder).samples) == count


def assert_holds(content, stop=400):
    assert content.samples.stamp_ns.tobytes() == SAMPLES.stamp_ns[:stop].tobytes()
    assert content.samples.xyz.tobytes() == SAMPLES.xyz[:stop].tobytes()
    assert content.path.points.tobytes() == CONTENT.path.points.tobytes()


def test_run_under_way_is_a_whole_bag_for_every_reader(journal):
    journal.message(PATH, path_cdr())
    journal.message(STATUS, b'\x00\x01\x00\x00\x01\x00\x00\x00\x00')
    put(journal, 0, 150)
    folder = journal.folder
    wait(lambda: readable(folder, 150))
    put(journal, 150, 400)
    wait(lambda: readable(folder, 400))
    content = read_bag(folder)
    assert_holds(content)
    assert content.remarks == ()
    assert_holds(read_with_anyreader(folder))
    (file,) = folder.glob('*.mcap')
    with file.open('rb') as stream:
        topics = [c.topic for _, c, _ in make_reader(stream).iter_messages()]
    assert topics.count('/tracker/point') == 400 and topics.count('/tracker/status') == 1


@pytest.mark.parametrize('step', ['_records', '_register', '_unpack', '_blocks'])
def test_reader_that_is_overtaken_gets_what_was_there(journal, monkeypatch, step):
    journal.message(PATH, path_cdr())
    put(journal, 0, 150)
    folder = journal.folder
    wait(lambda: readable(folder, 150))
    found = getattr(McapMessages, step)

    def overtaken_and_found(self, *arguments):
        if not overtaken:
            size = self._file.stat().st_size
            overtaken.append(step)
            put(journal, 150, 400)
            wait(lambda: self._file.stat().st_size > size)
        return found(self, *arguments)

    overtaken = []
    with monkeypatch.context() as patch:
        patch.setattr(McapMessages, step, overtaken_and_found)
        assert_holds(read_bag(folder), 150)
    wait(lambda: readable(folder, 400))
    assert_holds(read_bag(folder))


def test_closed_run_has_a_summary_and_its_state(journal):
    journal.message(PATH, path_cdr())
    put(journal)
    folder = journal.end('calibrated')
    assert journal.folder is None
    journal.close()
    assert state_of(folder) == 'calibrated'
    (file,) = folder.glob('*.mcap')
    with file.open('rb') as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        points = [m.data for _, _, m in reader.iter_messages(topics=['/tracker/point'])]
    assert summary.statistics.message_count == 401 and summary.chunk_indexes
    assert len(points) == 400
    assert_holds(read_with_anyreader(folder))


def test_every_run_is_a_folder_of_its_own_with_the_path(journal):
    journal.message(PATH, path_cdr())
    folders = []
    for start in (0, 200):
        put(journal, start, start + 200)
        folders.append(journal.end('set aside'))
    journal.close()
    stamps = [read_bag(folder).samples.stamp_ns for folder in folders]
    assert np.concatenate(stamps).tobytes() == SAMPLES.stamp_ns.tobytes()
    journal.directory.joinpath('notes').mkdir()
    assert unfinished_runs(journal.directory) == []


def crashed(journal):
    """The journal as a killed process leaves it: nothing is closed."""
    folder = journal.folder
    journal._thread.join(0)
    os.close(journal._lock)
    journal._lock = os.open(os.devnull, os.O_RDONLY)
    return folder


@pytest.mark.parametrize('torn', [0, 1, 3000])
def test_run_of_a_killed_process_is_taken_up_and_goes_on(journal, torn):
    journal.message(PATH, path_cdr())
    put(journal, 0, 100)
    wait(lambda: journal._pending == 0)
    put(journal, 100, 200)
    wait(lambda: readable(journal.folder, 200))
    folder = crashed(journal)
    file = folder / f'{folder.name}_0.mcap'
    file.write_bytes(file.read_bytes()[: file.stat().st_size - torn])
    kept = len(read_bag(folder).samples)
    assert kept == (200 if torn < 3000 else 100)

    again = Journal(journal.directory, TEXTS)
    recorded, left = again.take_up(600.0)
    assert left == [] and again.folder == folder
    (part,) = recorded.parts
    found = [p for t, p in part if t is POINT]
    stamps = np.concatenate([p.stamp_ns for p in found])
    assert stamps.tobytes() == SAMPLES.stamp_ns[:kept].tobytes()
    assert part[0][0] is PATH
    put(again, kept, 400)
    again.end('calibrated')
    again.close()
    assert_holds(read_bag(folder))
    assert_holds(read_with_anyreader(folder))
    assert len(list(folder.glob('*.mcap'))) == 2


def test_old_run_is_not_taken_up(journal):
    put(journal)
    folder = journal.folder
    journal.close()
    again = Journal(journal.directory, TEXTS)
    assert again.take_up(0.0) == (None, [folder])
    again.close()


def test_second_journal_in_one_directory_is_refused(journal):
    with pytest.raises(ConfigError, match=f'process {os.getpid()}.*another journal_directory'):
        Journal(journal.directory, TEXTS)


@pytest.mark.parametrize('what', ['a file', 'below a file'])
def test_directory_that_cannot_be_made_is_refused(tmp_path, what):
    (tmp_path / 'file').touch()
    place = tmp_path / 'file' / ('x' if what == 'below a file' else '')
    with pytest.raises(ConfigError, match='the journal cannot be kept there'):
        Journal(place, TEXTS)


def test_full_disk_is_said_and_nothing_is_missing_once_there_is_room(journal, monkeypatch):
    journal.message(PATH, path_cdr())
    put(journal, 0, 100)
    wait(lambda: readable(journal.folder, 100))
    real, full = os.pwrite, [True]

    def pwrite(file, data, at):
        if full[0] and len(data) > 200:
            real(file, data[:150], at)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(file, data, at)

    monkeypatch.setattr(journal_module.os, 'pwrite', pwrite)
    put(journal, 100, 250)
    wait(lambda: journal.trouble)
    assert 'No space left on device' in journal.trouble and 'in memory' in journal.trouble
    assert readable(journal.folder, 100)  # as it was, with its end
    put(journal, 250, 400)
    full[0] = False
    wait(lambda: not journal.trouble)
    wait(lambda: readable(journal.folder, 400))
    assert_holds(read_bag(journal.folder))


def test_room_for_the_results_is_left_on_the_disk(journal, monkeypatch):
    journal.message(PATH, path_cdr())
    put(journal, 0, 100)
    wait(lambda: readable(journal.folder, 100))
    room = SimpleNamespace(f_blocks=1000, f_frsize=4096, f_bavail=500)  # half of it is kept
    monkeypatch.setattr(journal_module.os, 'statvfs', lambda place: room)
    put(journal, 100, 250)
    wait(lambda: journal.trouble)
    assert 'disk full except for 2.0 MB reserved for the results' in journal.trouble
    assert readable(journal.folder, 100)
    room.f_bavail = 600
    wait(lambda: readable(journal.folder, 250))


def test_what_the_disk_never_took_is_counted(journal, monkeypatch):
    monkeypatch.setattr(journal_module, 'MAX_PENDING_BYTES', 5000)

    def refuse(*_):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(JournalFile, 'write', refuse)
    for start in range(0, 400, 50):
        put(journal, start, start + 50)
    wait(lambda: 'not in the journal' in journal.trouble)
    assert '300 messages are not in the journal' in journal.trouble
    monkeypatch.undo()


def test_run_that_somebody_removes_is_written_again(journal):
    journal.message(PATH, path_cdr())
    put(journal, 0, 200)
    folder = journal.folder
    wait(lambda: readable(folder, 200))
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()
    put(journal, 200, 400)
    wait(lambda: readable(folder, 400))
    assert_holds(read_bag(folder))


def test_foreign_frames_are_kept_as_they_came(journal):
    journal.message(PATH, path_cdr())
    put(journal, 0, 390)
    put(journal, 390, 400, frame='another')
    folder = journal.end('set aside')
    journal.close()
    content = read_bag(folder)
    assert_holds(content, 390)
    assert "frame_id is 'another'" in content.remarks[0]


def test_file_torn_at_any_byte_has_all_complete_chunks(tmp_path):
    texts = Definitions(TEXTS).both[0]
    file = JournalFile(tmp_path / 'a.mcap', texts)
    for start in range(0, 400, 40):
        part = slice(start, start + 40)
        rows = encode_points(SAMPLES.stamp_ns[part], SAMPLES.xyz[part], 'tracker')
        path = [] if start else [Rows(PATH, path_cdr(), len(path_cdr()), 1)]
        file.add([*path, Rows(POINT, rows.tobytes(), rows.dtype.itemsize, start)])
        file.write()
    file.close()
    with (tmp_path / 'a.mcap').open('rb') as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    ends = [c.chunk_start_offset + c.chunk_length for c in chunks]
    whole = (tmp_path / 'a.mcap').read_bytes()
    for cut in np.random.default_rng(11).integers(ends[0], len(whole), 40):
        (tmp_path / 'a.mcap').write_bytes(whole[:cut])
        complete = 40 * sum(end <= cut for end in ends)
        assert_holds(read_bag(tmp_path / 'a.mcap'), complete)
