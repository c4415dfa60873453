"""What is not as it was stored, or cannot be kept, is named by a move, and nothing is moved."""

from __future__ import annotations

import pytest
from rich_store import by_hand, rows_in

from calrig.store import StoreDamagedError, StoreError
from calrig.store.moving import move_store

DAMAGE = {
    "a pose": ("UPDATE pose SET reading_deg = reading_deg + 0.001 WHERE pose_index = 3", "pose 3 is not"),
    "a figure": ("UPDATE calibration SET scale = scale * 1.001 WHERE run_id = 4", "'calibration'.*run_id 4"),
    "a document": (
        "UPDATE event SET data = replace(data, '\"index\":7', '\"index\":8') WHERE run_id = 1",
        "'event' with run_id 1, seq 9.*a document is not what was stored",
    ),
    "a revision": (
        "UPDATE issued_calibration SET document = replace(document, 'scale', 'scalf') WHERE unit = 'a-2'",
        "'issued_calibration' with unit 'a-2', revision 1.*not what was issued",
    ),
    "the trail": ("UPDATE trail SET who = 'eve' WHERE seq = 2", "'trail' with seq 2.*trail is broken"),
    "an entry gone": ("DELETE FROM trail WHERE seq = 1", "'trail' with seq 2.*trail is broken"),
    "a pose gone": ("DELETE FROM pose WHERE run_id = 1 AND pose_index = 29", "1 poses of run .* are missing"),
    "an event gone": ("DELETE FROM event WHERE run_id = 1 AND seq = 5", "event 5 of this run is missing"),
    "no number": ("UPDATE pose SET reading_deg = 'warm' WHERE pose_index = 2", "no number in 'reading_deg'"),
    "no text": ("UPDATE run SET note = x'ff00' WHERE id = 2", "with id 2.*no text in 'note'"),
    "no character": (
        r"""UPDATE run SET provenance = '{"cable": "\ud800"}' WHERE id = 2""",
        "'run' with id 2.*surrogates",
    ),
    "not UTF-8": ("UPDATE run SET note = CAST(x'edA080' AS TEXT) WHERE id = 2", "decode to UTF-8.*'note'"),
    "a time": ("UPDATE unit SET created_at = 'noon'", "'unit' with serial 'A-2'.*a time is no time"),
    "no samples": ("UPDATE sample_block SET data = x'' WHERE id = 3", "'sample_block' with id 3.*unpacked"),
    "no transcript": ("UPDATE transcript SET data = x'' WHERE id = 1", "'transcript' with id 1.*unpacked"),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_what_is_not_as_it_was_stored_is_named_and_nothing_is_moved(source, new_database, what):
    there = new_database()
    statement, words = DAMAGE[what]
    with by_hand(source) as file:
        assert file.execute(statement).rowcount > 0
    with pytest.raises(StoreDamagedError, match=words) as said:
        move_store(f"sqlite:///{source}", there)
    assert str(source) in str(said.value)
    assert rows_in(there) == {}


def test_a_flipped_byte_of_raw_samples_is_named(source, new_database):
    there = new_database()
    with by_hand(source) as file:
        (packed,) = file.execute("SELECT data FROM sample_block WHERE id = 12").fetchone()
        flipped = bytearray(packed)
        flipped[len(flipped) // 2] ^= 1
        file.execute("UPDATE sample_block SET data = ? WHERE id = 12", (bytes(flipped),))
    with pytest.raises(StoreDamagedError, match=r"'sample_block' with id 12 \(run .*unpacked"):
        move_store(f"sqlite:///{source}", there)
    assert rows_in(there) == {}


NOT_KEPT = {
    "NUL in text": (
        "UPDATE run SET note = 'a' || char(0) || 'b' WHERE id = 2",
        "'note'.*id 2 is text with a NUL",
    ),
    "NaN in a document from before the checksums": (
        """UPDATE run SET provenance = '{"rate_hz": NaN}' WHERE id = 2""",
        "'provenance'.*id 2 is NaN",
    ),
    "a number of 64 bits": (
        "UPDATE run SET follows = 4294967296 WHERE id = 2",
        "'follows'.*id 2 is a number",
    ),
}


@pytest.mark.parametrize("what", NOT_KEPT)
def test_what_postgresql_cannot_keep_is_named_and_nothing_is_moved(source, new_database, what):
    there = new_database()
    statement, words = NOT_KEPT[what]
    with by_hand(source) as file:
        file.execute(statement)
    with pytest.raises(StoreError, match=words):
        move_store(f"sqlite:///{source}", there)
    assert rows_in(there) == {}
