"""The names of the numbers of contacts of a run."""

from carom.recording.read.recorded_impacts import RecordedImpacts
from carom.runs.outcome import EACH, ONCE_A_STEP, counts_text


def test_impacts_and_contact_steps_are_told_apart_and_said_how_they_were_counted() -> None:
    steps = "10969 touching pairs, summed over steps"
    assert counts_text(10969, 11001, EACH) == f"11001 impacts, {steps}"
    assert counts_text(10969, 529, ONCE_A_STEP) == f"529 impacts (counted once a pair and step), {steps}"
    assert counts_text(10969, 529, None) == f"529 impacts, {steps}", "another engine does not say"
    assert counts_text(10969, None, None) == steps


def test_contacts_of_which_only_the_frames_are_known_are_no_contact_steps() -> None:
    frames = "20 contacts in the recorded frames (pairs that touch, summed over these frames)"
    assert counts_text(20, None, None, "frames") == frames


def test_recorded_impacts_and_those_left_out_add_up_with_the_count() -> None:
    many = RecordedImpacts(17489, 65236)
    rows = "17489 recorded, the largest between frames; 65236 left out"
    assert many.text(82725) == many.text(None) == rows, "None: the count is unknown, as in a clip"
    assert many.text(82637) == f"{rows}; in all 82725, 88 of them too brief to be counted"
    assert RecordedImpacts(14).text(14) == "all 14 recorded"
    assert RecordedImpacts(14).text(12) == "all 14 recorded, 2 of them too brief to be counted"
    assert RecordedImpacts(1).text(1) == "the only one is recorded"
    assert RecordedImpacts().text(0) == "none"
