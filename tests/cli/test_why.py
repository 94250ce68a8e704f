"""`carom why`: what it prints and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from carom.recording.read.recording import Recording
from carom_command import carom


def test_the_answer_names_the_impact_and_the_command_to_look_at_it(folder: Path) -> None:
    done = carom("why", "run.rrd", "--body", "0", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Why does body 0 move as it does at t = 2 s?")
    assert "body 1 hits body 0" in done.stdout
    assert "carom view run.rrd --at 1" in done.stdout


def test_a_moment_within_a_step_is_answered_for_its_end_and_says_so(folder: Path) -> None:
    said = carom("why", "run.rrd", "--body", "0", "--at", "1.25", cwd=folder).stdout.splitlines()[1]
    assert said == "That is within a step; the answer is about its end, t = 1.3 s."
    assert "within a step" not in carom("why", "run.rrd", "--body", "0", "--at", "1.3", cwd=folder).stdout


def test_json_has_the_sum_the_causes_the_chain_and_the_cone(folder: Path) -> None:
    told = json.loads(carom("why", "run.rrd", "--event", "impact:1", "--json", cwd=folder).stdout)
    assert told["question"]["ends"] == [0, 1] and told["question"]["event"] == "impact:1"
    assert [account["velocity"] for account in told["accounts"]] == [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]
    told = json.loads(carom("why", "run.rrd", "--body", "1", "--json", cwd=folder).stdout)
    (cause,) = told["accounts"][0]["causes"]
    assert cause["with"] == 0 and cause["kind"] == "impact" and cause["approach_speed"] == pytest.approx(2.0)
    assert told["accounts"][0]["unexplained"] <= 1e-15
    assert told["chain"][0]["by"] == told["first_cause"]["body"] == 0
    assert [entry["body"] for entry in told["cone"]["bodies"]] == told["cone"]["closed"] == [0, 1]


def test_a_body_at_rest_has_no_shares_and_one_that_fell_no_chain(tmp_path: Path) -> None:
    (tmp_path / "fall.toml").write_text(
        "gravity = {constant = 0, uniform = [0, 0, -9.81]}\ntime = {duration = 0.5, fixed_dt = 0.05}\n[[plane]]\n"
        "[[body]]\nposition = [0, 0, 1]\nradius = 1\nmass = 1\n[[body]]\nposition = [9, 0, 9]\nradius = 1\nmass = 1\n"
    )
    carom("run", "fall.toml", "-o", "fall.rrd", cwd=tmp_path)
    rests = carom("why", "fall.rrd", "--body", "0", cwd=tmp_path).stdout
    assert "Contacts hold body 0 still" in rests and "plane 0: 4.905 N s" in rests and "%" not in rests
    fell = carom("why", "fall.rrd", "--body", "1", cwd=tmp_path).stdout
    assert "100%  forces gave it" in fell and "forces since then 100%" in fell
    assert "There is no chain of causes: 0 impacts passed on 0.0% of the velocity from other bodies." in fell


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "choose a body with --body"),
        (("--body", "0", "--event", "impact"), "choose a body with --body"),
        (("--body", "9"), 'has no body "9"; its bodies are 0 to 1'),
        (("--body", "0", "--at", "7"), "covers 0 to 2 s; 7 s is outside"),
        (("--body", "0", "--at", "0"), "earlier causes are unknown"),
        (("--body", "0", "--at", "1", "--from", "1.5"), "is later than 1 s, the time of the question"),
        (("--event", "bang"), 'has no event "bang"; there are'),
        (("--event", "contacts"), "ask about one with --body"),
        (("--event", "impact:1", "--at", "1"), "give --at or --event, not both"),
    ],
)
def test_a_mistake_is_one_sentence_and_exit_code_2(folder: Path, options: tuple[str, ...], message: str) -> None:
    done = carom("why", "run.rrd", *options, cwd=folder)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_the_bodies_and_contacts_behind_it_are_written_for_the_viewer(folder: Path) -> None:
    done = carom("why", "run.rrd", "--body", "0", "-o", "why.rrd", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.rstrip().endswith("why.rrd written; carom view why.rrd")
    found = Recording.open(folder / "why.rrd")
    paths = {entry.entity_path for entry in found.store.entries}
    assert found.is_overlay and {"world/cone", "world/edges", "graph", "why"} <= paths
    done = carom("why", "run.rrd", "--body", "0", "-o", "run.rrd", "--force", cwd=folder)
    assert done.returncode == 2 and "is the recording itself" in done.stderr
