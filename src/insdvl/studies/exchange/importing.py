"""The command `insdvl import`: text files of sensors to a recording."""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from insdvl.arrays import Array, Stamps
from insdvl.files import finite
from insdvl.messages.topics import DVL, DVL_WITH_COVARIANCE, IMU, TRUTH
from insdvl.recordings.bag_writer import BagWriter
from insdvl.recordings.base import Raw, encode
from insdvl.recordings.messages import imu_message, odometry_message, twist_message
from insdvl.studies.document import check_place, tell
from insdvl.studies.exchange.maps import MapError, SourceMap, read_map
from insdvl.studies.exchange.stamps import even_out
from insdvl.studies.exchange.tables import Table, check_stamps, lines_text, read_table


class Stream(NamedTuple):
    """The messages of a file, and what to say of it.

    Attributes:
        raws: The messages.
        facts: The same for the JSON document.
        said: One line.
    """

    raws: list[Raw]
    facts: dict[str, Any]
    said: str


def run(arguments: argparse.Namespace) -> int:
    """Import. The exit code is 2 if the input is refused; then nothing is written."""
    try:
        check_place(arguments.json)
        streams = _import(arguments)
        out = arguments.out
        document = {"bag": str(out), "files": [stream.facts for stream in streams]}
        lines = [*(stream.said for stream in streams), f"{out}: next, insdvl check {out}"]
        tell(arguments.json, document, "\n".join(lines))
    except (ValueError, OSError) as error:
        for line in str(error).splitlines():
            print(f"insdvl import: {line}", file=sys.stderr)
        return 2
    return 0


def _import(arguments: argparse.Namespace) -> list[Stream]:
    """Write the recording; what is in it."""
    out: Path = arguments.out
    if out.exists() or out.is_symlink():
        raise MapError(f"--out {out} exists already and is not overwritten")
    told = read_map(arguments.map)
    files = {"imu": arguments.imu, "dvl": arguments.dvl, "truth": arguments.truth}
    streams = []
    for name, path in files.items():
        if path is None:
            continue
        if name not in told.sources:
            raise MapError(f"{arguments.map} has no section {name}, which {path} needs")
        source = told.sources[name]
        table = read_table(path, source)
        table = table._replace(stamps_ns=table.stamps_ns + told.stamp_offset_ns)
        streams.append(_stream(path, source, table))
    with BagWriter(out) as bag:
        for raw in sorted((r for s in streams for r in s.raws), key=lambda raw: raw.time_ns):
            bag.write(raw)
    return streams


def _stream(path: Path, source: SourceMap, table: Table) -> Stream:
    """The messages of a file, recorded at the stamps that it has."""
    arrivals_ns = table.stamps_ns
    check_stamps(path, arrivals_ns)
    said = f"{path}: {len(arrivals_ns)} rows"
    facts: dict[str, Any] = {
        "file": str(path),
        "sensor": source.source,
        "rows": len(arrivals_ns),
        "duration": None,
        "rate": None,
        "lines_left_out": [int(line) for line in table.left_out],
        "delays": None,
    }
    if len(arrivals_ns) > 1:
        seconds = float(arrivals_ns.max() - arrivals_ns.min()) * 1e-9
        rate = (len(arrivals_ns) - 1) / seconds if seconds > 0.0 else float("nan")
        said += f" in {seconds:.6g} s, {rate:.4g} Hz"
        facts |= {"duration": seconds, "rate": finite(rate)}
    if table.left_out:
        said += f"; {len(table.left_out)} without a number left out (lines "
        said += f"{lines_text(table.left_out)})"
    stamps_ns = arrivals_ns
    if source.arrival:
        try:
            evened = even_out(arrivals_ns)
        except ValueError as error:
            raise MapError(f"{path}: {error}") from error
        stamps_ns = evened.stamps_ns
        check_stamps(path, stamps_ns)
        middle, longest = float(np.median(evened.delays)), float(evened.delays.max())
        facts["rate"], facts["delays"] = evened.rate, {"median": middle, "longest": longest}
        said += (
            f"; stamps of arrival evened out to {evened.rate:.5g} Hz, delays of "
            f"{1e3 * middle:.2g} ms, at most {1e3 * longest:.2g} ms"
        )
    make = {"imu": _imu, "dvl": _dvl, "truth": _truth}[source.source]
    raws = [
        raw._replace(time_ns=int(time_ns))
        for raw, time_ns in zip(make(path, source, table, stamps_ns), arrivals_ns, strict=True)
    ]
    return Stream(raws, facts, said)


def _imu(path: Path, source: SourceMap, table: Table, stamps_ns: Stamps) -> Iterator[Raw]:
    f = _rate(path, table, "specific_force", "velocity_increment", stamps_ns) @ source.axes.T
    w = _rate(path, table, "angular_rate", "angle_increment", stamps_ns) @ source.axes.T
    for k, stamp_ns in enumerate(stamps_ns.tolist()):
        yield encode(f"/{IMU}", stamp_ns, imu_message(stamp_ns, "imu_link", f[k], w[k]))


def _rate(path: Path, table: Table, rate: str, increment: str, stamps_ns: Stamps) -> Array:
    """A rate, or increments over the interval of the samples, which is the same for all."""
    if rate in table.values:
        return table.values[rate]
    interval = float(np.median(np.diff(stamps_ns))) * 1e-9 if len(stamps_ns) > 1 else 0.0
    if interval <= 0.0:
        raise MapError(f"{path}: {increment} needs stamps that increase, to divide by their step")
    return table.values[increment] / interval


def _dvl(path: Path, source: SourceMap, table: Table, stamps_ns: Stamps) -> Iterator[Raw]:
    single = "speed" in table.values
    sigma = table.values.get("sigma")
    if single:  # along the first axis of the file
        speed = table.values["speed"]
        v = np.concatenate([speed, np.zeros((len(speed), 2))], axis=1)
        variance = np.full(v.shape, np.inf)
        variance[:, 0] = 0.0 if sigma is None else _variance(path, sigma)[:, 0]
    else:
        v = table.values["velocity"]
        variance = np.zeros(v.shape) if sigma is None else _variance(path, sigma)
    v, variance = v @ source.axes.T, _turned(variance, source.axes)
    with_covariance = single or sigma is not None
    topic = DVL_WITH_COVARIANCE if with_covariance else DVL
    for k, stamp_ns in enumerate(stamps_ns.tolist()):
        R = np.diag(variance[k]) if with_covariance else None
        yield encode(f"/{topic}", stamp_ns, twist_message(stamp_ns, "dvl_link", v[k], R))


def _variance(path: Path, sigma: Array) -> Array:
    """Of sigmas; 0, which means unknown, where there is none."""
    if (sigma < 0.0).any():
        raise MapError(f"{path}: a sigma is {float(sigma.min()):g}, at least 0 is possible")
    return np.nan_to_num(sigma) ** 2


def _turned(variance: Array, axes: Array) -> Array:
    """Variances (N, 3) along other axes; the axes differ in order and signs only."""
    return variance[:, np.argmax(np.abs(axes), axis=1)]


def _truth(path: Path, source: SourceMap, table: Table, stamps_ns: Stamps) -> Iterator[Raw]:
    values = table.values
    if "quaternion" in values:
        q = values["quaternion"]
        norms = np.linalg.norm(q, axis=1)
        if (np.abs(norms - 1.0) > 0.01).any():
            raise MapError(
                f"{path}: a quaternion has the length {float(norms[np.abs(norms - 1).argmax()]):g}"
            )
        C = Rotation.from_quat(q).as_matrix()
    else:
        C = Rotation.from_euler("xyz", values["rpy"]).as_matrix()
    to_nav, to_body = source.navigation_axes, source.axes
    C = to_nav @ C @ to_body.T
    p = values["position"] @ to_nav.T
    if "velocity" in values and source.velocity_in == "body":
        v = values["velocity"] @ to_body.T
    else:
        v_n = (
            values["velocity"] @ to_nav.T
            if "velocity" in values
            else _derivative(path, p, stamps_ns)
        )
        v = np.einsum("kji,kj->ki", C, v_n)
    q_xyzw = Rotation.from_matrix(C).as_quat()
    for k, stamp_ns in enumerate(stamps_ns.tolist()):
        message = odometry_message(
            stamp_ns, ("odom", "base_link"), p[k], q_xyzw[k], v[k], np.zeros(3)
        )
        yield encode(f"/{TRUTH}", stamp_ns, message)


def _derivative(path: Path, p: Array, stamps_ns: Stamps) -> Array:
    t = (stamps_ns - stamps_ns[0]) * 1e-9
    if len(t) < 2 or not (np.diff(t) > 0.0).all():
        raise MapError(f"{path}: without a velocity the stamps must increase, in two rows or more")
    return np.gradient(p, t, axis=0)
