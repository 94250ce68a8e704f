"""Recordings of a few megabytes whose chunks claim as much memory as carom lets them.

    python inflated_recordings.py FOLDER

writes one for each entity of a run and takes it through every command that reads recordings, each in a process of its
own. A line of JSON for each says how the command ended and how much memory it took; one above `BOUND` is a fault.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa

import carom
from carom.recording.rrd.framing import CHUNK
from carom.recording.rrd.messages import RECORDING, decode
from edited_recordings import assembled, messages_of, repacked, stream, with_column

BOUND = 512_000_000  # bytes that a command may take for a file, beyond what it takes for a small one
TIMES = 7  # size of a chunk over its file; carom refuses more than 8
ROOMY = 60_000_000  # bytes of a chunk in any file; carom refuses more than 67 million
PACKED = 16_000_000  # bytes of a file
SLOWEST = 120.0  # s
RUN, ATTACK = "run.rrd", "inflated-"
COMMANDS = (
    "inspect FILE",
    "repair FILE -o fixed.rrd --force",
    "clip FILE --from 0 --to 1 -o part.rrd --force",
    "export FILE -o table.csv --force",
    "contacts FILE --impacts",
    "replay FILE",
    "resume FILE -o more.rrd --force",
    "diff FILE run.rrd",
    "why FILE --body 0 --at 0.05",
)


def inflated(body: bytes, noise: int, unpacked: int) -> bytes | None:
    """Return a chunk whose last row has ``unpacked`` bytes, ``noise`` of them random; None without numbers."""
    _, chunk = decode(body)
    batch = chunk.batch
    for name in chunk.components:
        kind = batch[name].type
        leaf, width = kind.value_type, 1
        while pa.types.is_list(leaf) or pa.types.is_fixed_size_list(leaf):
            width *= leaf.list_size if pa.types.is_fixed_size_list(leaf) else 1
            leaf = leaf.value_type
        if not (pa.types.is_floating(leaf) or pa.types.is_integer(leaf)) or pa.types.is_list(kind.value_type):
            continue
        each = leaf.bit_width // 8 * width
        count = unpacked // each
        raw = np.zeros(count * each, np.uint8)
        raw[:noise] = np.random.default_rng(1).integers(0, 50, noise, np.uint8)
        values = pa.Array.from_buffers(leaf, count * width, [None, pa.py_buffer(raw)])
        if width > 1:
            values = pa.FixedSizeListArray.from_arrays(values, type=kind.value_type)
        rows = batch.num_rows
        offsets = pa.array([0] * rows + [count], pa.int32())
        return repacked(body, stream(with_column(batch, name, pa.ListArray.from_arrays(offsets, values, type=kind))))
    return None


def attacks(source: Path, folder: Path) -> Iterator[Path]:
    """Write a recording for each entity, with its chunks inflated: one of the largest size, or two of the roomiest."""
    parts = messages_of(source)
    entities: dict[tuple[str, bool], list[int]] = {}
    for k, (kind, body) in enumerate(parts):
        if kind == CHUNK:
            store, chunk = decode(body)
            if store.kind == RECORDING:
                entities.setdefault((chunk.entity_path, chunk.is_static), []).append(k)
    for (entity, static), places in entities.items():
        for footer in (True, False):
            made, noise = list(parts), PACKED if len(places) == 1 else 0
            for k in places:
                if (larger := inflated(parts[k][1], noise, TIMES * noise or ROOMY)) is not None:
                    made[k] = (CHUNK, larger)
            if made != parts:
                rows = "static" if static else "moving"
                name = f"{ATTACK}{entity.replace('/', '-')}-{rows}-{'whole' if footer else 'killed'}.rrd"
                yield assembled(source, folder / name, made, footer)


def peak(command: str, folder: Path) -> tuple[int, int, float, str]:
    """Run a command; return its exit code, the memory that it took (bytes), its time (s) and what it said last."""
    began = time.monotonic()
    with subprocess.Popen(
        [sys.executable, "-m", "carom", *shlex.split(command)],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
    ) as child:
        assert child.stderr is not None
        said = child.stderr.read().decode(errors="replace")
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    return child.returncode, used.ru_maxrss * 1024, time.monotonic() - began, said


def write(folder: Path, only: str) -> None:
    """Write a run and its inflated copies; in a process of its own, since a child's memory counts from its parent's."""
    source = carom.run(carom.Scene.load("rack-break", ["time.duration=0.1"]), folder / RUN, force=True).path
    for path in attacks(source, folder):
        if only not in path.name:
            path.unlink()


def main(folder: Path, only: str = "") -> int:
    """Judge every command on every recording; return the number of faults."""
    subprocess.run([sys.executable, __file__, "--write", folder, only], check=True, stdout=subprocess.DEVNULL)
    usual = {command: peak(command.replace("FILE", RUN), folder)[1] for command in COMMANDS}
    faults = 0
    for path in sorted(folder.glob(f"{ATTACK}*.rrd")):
        for command in COMMANDS:
            code, memory, seconds, said = peak(command.replace("FILE", path.name), folder)
            more, wrong = memory - usual[command], ""
            if more > BOUND:
                wrong = "memory"
            elif code not in (0, 1, 2) or "Traceback" in said:
                wrong = "ending"
            elif seconds > SLOWEST:
                wrong = "time"
            faults += bool(wrong)
            document = {"file": path.name, "command": command, "code": code, "MB": more // 10**6, "wrong": wrong}
            last = said.strip().splitlines()[-1:] or [""]
            print(json.dumps(document | {"s": round(seconds, 1), "said": last[0][:200]}), flush=True)  # noqa: T201
        path.unlink()
    return faults


if __name__ == "__main__":
    if sys.argv[1] == "--write":
        write(Path(sys.argv[2]), sys.argv[3])
    else:
        sys.exit(main(Path(sys.argv[1]), *sys.argv[2:3]) > 0)
