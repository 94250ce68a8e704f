"""The names of the numbers of contacts of a run."""

from carom.runs.outcome import EACH, ONCE_A_STEP, counts_text


def test_impacts_and_contact_steps_are_told_apart_and_said_how_they_were_counted() -> None:
    steps = "10969 contact-steps (pairs that touch, summed over steps)"
    assert counts_text(10969, 11001, EACH) == f"11001 impacts, {steps}"
    assert counts_text(10969, 529, ONCE_A_STEP) == f"529 impacts (counted once a pair and step), {steps}"
    assert counts_text(10969, 529, None) == f"529 impacts, {steps}", "an older recording does not say"
    assert counts_text(10969, None, None) == steps


def test_contacts_of_which_only_the_frames_are_known_are_no_contact_steps() -> None:
    frames = "20 contacts in the recorded frames (pairs that touch, summed over these frames)"
    assert counts_text(20, None, None, "frames") == frames
