"""Files that recorders leave behind and that cannot be read as they are: what mends them.

A recorder that was killed, a compressed file, a bag of ROS 1, a folder without metadata: each is
named, with the command that makes a recording of it.
"""

from pathlib import Path

_ZSTD, _ROS_1, _MCAP = b"\x28\xb5\x2f\xfd", b"#ROSBAG V", b"\x89MCAP0\r\n"
#: Storages, by the suffixes of their files.
STORAGES = {".mcap": "mcap", ".db3": "sqlite3"}
_TEXTS = (".csv", ".txt", ".tsv", ".log")
_COMPRESSED = (".zst", ".zstd")


def remedy_of_file(path: Path) -> str:
    """What a file is, and the command that mends it; empty where it is nothing that is known."""
    with path.open("rb") as file:
        begin = file.read(16)
        file.seek(max(path.stat().st_size - len(_MCAP), 0))
        end = file.read()
    if begin.startswith(_ROS_1):
        return f"it is a bag of ROS 1: rosbags-convert --src {path} --dst {path.with_suffix('')}"
    if begin.startswith(_ZSTD):
        plain = path.with_suffix("") if path.suffix in _COMPRESSED else f"plain-{path.name}"
        return f"it is compressed: zstd -d {path} -o {path.parent / plain}"
    if begin.startswith(_MCAP) and end != _MCAP:
        mended = path.with_name(f"{path.stem}-recovered.mcap")
        return f"its end is missing, the recorder was killed: mcap recover {path} -o {mended}"
    if path.suffix.lower() in _TEXTS:
        return "insdvl import makes a recording of text files"
    return ""


def files_of(path: Path) -> list[Path]:
    """The files of a folder that hold messages."""
    return sorted(file for file in path.iterdir() if file.suffix in STORAGES and file.is_file())


def remedy_of_folder(path: Path) -> str:
    """What mends a folder without metadata.yaml; empty where it has no file of a recording."""
    files = files_of(path)
    if not files:
        return ""
    alone = f", or read {files[0]} alone" if len(files) == 1 else ""
    return f"ros2 bag reindex {path} writes it{alone}"


def unfinished_log(path: Path) -> str:
    """The -wal file of a database whose recorder was killed; empty where there is none.

    It holds messages that are not in the database yet.
    """
    log = path.with_name(path.name + "-wal")
    if not log.is_file() or not log.stat().st_size:
        return ""
    return (
        f"{log.name} beside it holds messages that are not in it yet, the recorder was killed: "
        f"sqlite3 {path} 'PRAGMA wal_checkpoint(TRUNCATE)'"
    )
