"""Writes an answer for the viewer."""

from __future__ import annotations

from pathlib import Path

from carom.lab.why.answer import Answer
from carom.recording.read.recording import Recording
from carom.show.causes import CauseEdge, Causes, write_causes


def write_answer(out: Path, recording: Recording, answer: Answer, text: str) -> None:
    """Write the bodies and contacts behind an answer. RecordingError if it cannot be written."""
    cone = answer.cone
    edges = [CauseEdge(edge.i, edge.j, edge.first, edge.share) for edge in answer.edges if edge.j < cone.count]
    write_causes(
        out,
        recording,
        Causes(
            title=answer.question.text,
            text=text,
            begin=answer.begin,
            end=answer.time,
            asked=answer.question.bodies,
            share=cone.shares + cone.from_forces,
            edges=edges,
        ),
    )
