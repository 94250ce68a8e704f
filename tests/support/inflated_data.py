"""Data files of 20 MB with as many bodies as their format can claim, in every format, and what it takes to read them.

    python inflated_data.py FOLDER [FORMAT]

prints a line of JSON for each: how ``carom explain`` ended, and its memory; above `BOUND` it is a fault.
"""

from __future__ import annotations

import base64
import importlib
import itertools
import json
import random
import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from inflated_recordings import BOUND, peak

Writer = Callable[[Path, int], object]
SIZE = 20_000_000  # bytes of each file: what its bodies do not fill is noise
ROWS = 2_000_000  # bodies that it claims: as many as carom reads, and ten times as many
SCENE = 'bodies = [{{ file = "{}", radius = 1.0, mass = 1.0{} }}]\n'
FLAT = ', columns = { position = ["x", "y"] }'


def noise(missing: int) -> np.ndarray:
    return np.frombuffer(random.Random(1).randbytes(max(0, missing)), np.uint8)


def npz(path: Path, rows: int) -> None:
    np.savez_compressed(path, position=np.zeros((rows, 3), np.float32), more=noise(SIZE))


def hdf5(path: Path, rows: int) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("position", (rows, 3), "i1", fillvalue=0, chunks=(100_000, 3), compression="gzip")
        file["more"] = noise(SIZE)


def gsd(path: Path, rows: int) -> None:
    import gsd.fl

    with gsd.fl.open(str(path), "w", application="x", schema="hoomd", schema_version=[1, 4]) as file:
        file.write_chunk("particles/N", np.array([min(rows, SIZE // 12)], np.uint32))
        file.write_chunk("particles/position", np.zeros((min(rows, SIZE // 12), 3), np.float32))
        file.end_frame()


def arrow(path: Path, rows: int) -> None:
    import pyarrow as pa
    import pyarrow.feather

    zeros = pa.array(np.zeros(rows, np.int8))
    table = pa.table({"x": zeros, "y": zeros, "z": zeros, "more": pa.array(np.resize(noise(SIZE), (rows,)))})
    pyarrow.feather.write_feather(table, path, compression="zstd")


def parquet(path: Path, rows: int) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    zeros = pa.array(np.zeros(rows, np.int8))
    table = pa.table({"x": zeros, "y": zeros, "z": zeros, "more": pa.array(np.resize(noise(SIZE), (rows,)))})
    pq.write_table(table, path, use_dictionary=["x", "y", "z"])


def words(write: Callable[[object, Path], None]) -> Writer:
    """Return what writes the same long name for each of 2 million bodies, stored once."""

    def made(path: Path, rows: int) -> None:
        import pyarrow as pa

        name = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int8)), pa.array(["a" * 1000]))
        zeros = pa.array(np.zeros(rows, np.int8))
        write(pa.table({"x": zeros, "y": zeros, "z": zeros, "name": name}), path)

    return made


def lines(row: str, head: str = "", tail: str = "") -> Writer:
    """Return what writes as many rows as fit below a head, in which @ is their number; the last one fills the file."""

    def made(path: Path, rows: int) -> None:
        count = min(rows, SIZE // len(row))
        begin = head.replace("@", str(count))
        zeros = "0" * (SIZE // count - len(row))
        path.write_text(begin + row.replace("0", "0" + zeros, 1) * count + tail, encoding="ascii")

    return made


def vtk(path: Path, rows: int) -> None:
    count = min(rows, SIZE // 3)
    head = f"# vtk DataFile Version 3.0\nx\nBINARY\nDATASET POLYDATA\nPOINTS {count} char\n"
    path.write_bytes(head.encode() + bytes(3 * count) + b"\n" + bytes(max(0, SIZE - 3 * count)))


def vtp(path: Path, rows: int, pieces: int = 1) -> None:
    count = rows // pieces
    packed = zlib.compress(bytes(3 * count))
    data = base64.b64encode(struct.pack("<4I", 1, 3 * count, 0, len(packed))) + base64.b64encode(packed)
    array = '<DataArray type="Int8" NumberOfComponents="3" format="appended" offset="0"/>'
    piece = f'<Piece NumberOfPoints="{count}"><Points>{array}</Points></Piece>' * pieces
    path.write_bytes(
        f'<VTKFile type="PolyData" compressor="vtkZLibDataCompressor"><PolyData>{piece}</PolyData>'
        '<AppendedData encoding="base64">_'.encode()
        + data
        + b"A" * (SIZE - len(data))
        + b"</AppendedData></VTKFile>"
    )


FORMATS: dict[str, Writer] = {
    **{"a.npz": npz, "a.h5": hdf5, "a.gsd": gsd, "a.feather": arrow, "a.parquet": parquet},
    **{"a.csv": lines("0,0,0\n", "x,y,z\n"), "flat.csv": lines("0,0\n", "x,y\n"), "a.txt": lines("0 0 0\n", "x y z\n")},
    "names.parquet": words(lambda table, path: importlib.import_module("pyarrow.parquet").write_table(table, path)),
    "names.feather": words(lambda table, path: importlib.import_module("pyarrow.feather").write_feather(table, path)),
    "a.xyz": lines("A 0 0 0\n", "@\n\n"),
    "a.dump": lines("0 0 0\n", "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n@\nITEM: ATOMS x y z\n"),
    "a.lmp": lines("1 1 0 0 0\n", "title\n\n@ atoms\n\nAtoms # atomic\n\n"),
    "a.data": lines("0 0 0 0 0 0 1 0 0 0 0 0 0 0\n", "@ 0 0 0 0 1 1 1\n"),
    "ascii.vtk": lines("0 0 0\n", "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS @ char\n"),
    "ascii.vtp": lines(
        "0 0 0 ",
        '<VTKFile type="PolyData"><PolyData><Piece NumberOfPoints="@"><Points><DataArray type="Float32" '
        'NumberOfComponents="3" format="ascii">',
        "</DataArray></Points></Piece></PolyData></VTKFile>",
    ),
    **{"a.vtk": vtk, "a.vtp": vtp, "pieces.vtp": lambda path, rows: vtp(path, rows, 1000)},
}


def main(folder: Path, only: str = "") -> int:
    """Judge every format; return the number of faults."""
    (folder / "scene.toml").write_text(SCENE.format("few.csv", ""), encoding="ascii")
    (folder / "few.csv").write_text("x,y,z\n0,0,0\n1,0,0\n", encoding="ascii")
    usual, faults = peak("explain scene.toml", folder)[1], 0
    for name, rows in itertools.product([each for each in FORMATS if only in each], (ROWS, 10 * ROWS)):
        FORMATS[name](folder / name, rows)
        (folder / "scene.toml").write_text(SCENE.format(name, FLAT if "flat" in name else ""), encoding="ascii")
        code, memory, seconds, said = peak("explain scene.toml", folder)
        wrong = "memory" if memory - usual > BOUND else "ending" if code != 2 or "Traceback" in said else ""
        faults += bool(wrong)
        document = {
            "file": name,
            "rows": rows,
            "size": (folder / name).stat().st_size,
            "code": code,
            "MB": (memory - usual) // 10**6,
        }
        last = (said.strip().splitlines()[-1:] or [""])[0]
        print(json.dumps(document | {"wrong": wrong, "s": round(seconds, 1), "said": last}), flush=True)  # noqa: T201
        (folder / name).unlink()
    return faults


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), *sys.argv[2:3]) > 0)
