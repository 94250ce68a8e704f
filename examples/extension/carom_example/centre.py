"""`carom centre`: the centre of mass of a recording."""

from __future__ import annotations

from carom.extend import JsonOption, RecordingArgument, say


def centre(file: RecordingArgument, as_json: JsonOption = False) -> None:
    """Print the centre of mass at the start and at the end of a recording, in metres."""
    import json

    from carom import Recording

    recording = Recording.open(file)
    mass = recording.bodies.mass
    centres = {}
    for name, step in (("start", 0), ("end", int(recording.checkpoint_steps[-1]))):
        position = recording.checkpoint(step).position
        centres[name] = [float(sum(mass * position[:, k]) / sum(mass)) for k in range(3)]
    say(json.dumps(centres) if as_json else "\n".join(f"{name}: {place}" for name, place in centres.items()))
