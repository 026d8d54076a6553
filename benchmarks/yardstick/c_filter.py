"""Builds filter.c with the compiler that is here, and gives it the states and samples of a fold."""

import ctypes
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from insdvl.arrays import Array, Records

SOURCE = Path(__file__).parent / "filter.c"
_FLAGS = ["-O3", "-std=c11", "-D_GNU_SOURCE", "-shared", "-fPIC", "-Wno-psabi"]
_AVX2 = ["-mavx2", "-mfma"]

_Vector = ctypes.c_double * 3
_Pair = ctypes.c_double * 2
_Matrix = ctypes.c_double * 9


class State(ctypes.Structure):
    """As in filter.c; it is aligned by `new_state`."""

    _fields_ = (
        ("C", _Matrix),
        ("v", _Vector),
        ("llh", _Vector),
        ("llh_r", _Vector),
        ("bend", _Pair),
        ("b_f", _Vector),
        ("b_w", _Vector),
        ("w_before", _Vector),
        ("seconds", ctypes.c_double),
        ("h_0", ctypes.c_double),
        ("padding", ctypes.c_double * 5),
        ("P", (ctypes.c_double * 16) * 15),
    )


class Noise(ctypes.Structure):
    """As in filter.c: densities."""

    _fields_ = tuple((name, ctypes.c_double) for name in ("S_f", "S_w", "eps_f", "eps_w"))


@dataclass(frozen=True)
class Compiled:
    """The library, and how it was compiled."""

    library: ctypes.CDLL
    how: str


def compiled(folder: Path) -> Compiled | str:
    """Compile filter.c into a folder; a sentence says why not, where it cannot be done."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return "the C yardstick is left out: no C compiler (cc, gcc or clang) is on the PATH"
    try:
        has = Path("/proc/cpuinfo").read_text()
    except OSError:
        has = ""
    vectors = _AVX2 if " avx2 " in has and " fma " in has else []
    target = folder / "filter.so"
    done = subprocess.run(
        [compiler, *_FLAGS, *vectors, "-o", str(target), str(SOURCE), "-lm"],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        return f"the C yardstick is left out: {compiler} fails: {done.stderr.strip()[:200]}"
    library = ctypes.CDLL(str(target))
    double, pointer = ctypes.c_double, ctypes.c_void_p
    library.mission.argtypes = [pointer] * 5 + [ctypes.c_long] * 2 + [double] * 2
    library.updates.argtypes = [pointer, pointer, double, ctypes.c_long]
    library.mission.restype = library.updates.restype = None
    return Compiled(library, " ".join([Path(compiler).name, *_FLAGS[:1], *vectors]))


def new_state() -> tuple[State, NDArray[np.uint8]]:
    """A state at an address that is a multiple of 32, and the memory that holds it."""
    memory = np.zeros(ctypes.sizeof(State) + 32, np.uint8)
    offset = -memory.ctypes.data % 32
    return State.from_buffer(memory.data, offset), memory


def state_of(record: Records, w_ib_b: Array) -> tuple[State, NDArray[np.uint8]]:
    """The state of a filter's record (1,), and the memory that holds it.

    Args:
        record: Of a filter without optional states whose IMU is in base_link.
        w_ib_b: (3,) angular rate that the IMU read last [rad/s].
    """
    nav, (state, memory) = record[0]["nav"], new_state()
    for name, value in (
        ("C", nav["C_n_b"]),
        ("v", nav["v_n"]),
        ("llh", nav["llh"]),
        ("llh_r", nav["llh_r"]),
        ("bend", nav["bend_n"]),
        ("b_f", nav["b_f"]),
        ("b_w", nav["b_w"]),
        ("w_before", w_ib_b),
    ):
        np.ctypeslib.as_array(getattr(state, name))[:] = np.ravel(value)
    state.seconds = (nav["time_ns"] - nav["start_ns"]) * 1e-9
    state.h_0 = nav["h_0"]
    np.ctypeslib.as_array(state.P)[:, :15] = nav["P"][:15, :15]
    return state, memory


def difference(state: State, record: Records) -> float:
    """Largest relative difference of the numbers of both.

    Elements of P are compared with the sigmas of their row and column, and vectors with their
    length, at least one unit.
    """
    nav, worst = record[0]["nav"], 0.0
    for name in ("C", "v", "llh", "b_f", "b_w"):
        ours = np.ctypeslib.as_array(getattr(state, name))
        theirs = np.ravel(nav[{"C": "C_n_b", "v": "v_n"}.get(name, name)])
        worst = max(worst, float(np.abs(ours - theirs).max() / max(1.0, np.abs(theirs).max())))
    P, sigma = nav["P"][:15, :15], np.sqrt(np.diag(nav["P"])[:15])
    of_P = np.abs(np.ctypeslib.as_array(state.P)[:, :15] - P) / np.outer(sigma, sigma)
    return max(worst, float(of_P.max()))
