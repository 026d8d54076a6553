"""Writing a rosbag2 recording without ROS."""

import shutil
import sqlite3
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any, final

from insdvl.extras import extra
from insdvl.recordings.base import BagError, Raw, typestore_with

with extra("bags"):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

STORAGES = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}


@final
class BagWriter:
    """A new recording; a context manager.

    It is written under a hidden name beside its place and renamed when it is complete. Leaving the
    ``with`` block by an exception leaves nothing behind.

    Attributes:
        path: Folder of the recording, once it is complete.
        folder: Where it is until then; other files that are put there go with it.
    """

    def __init__(
        self, path: Path, storage: str = "mcap", *, name: str = "", compressed: bool = False
    ) -> None:
        """Begin a recording.

        Args:
            path: Folder of the recording; it must not exist.
            storage: ``mcap`` or ``sqlite3``.
            name: Of its data file, without suffix; that of the folder by default.
            compressed: Whether the chunks of an MCAP file are compressed by zstd, as ``ros2 bag``
                reads them.

        Raises:
            BagError: The path exists already, or the folder cannot be made.
        """
        if storage not in STORAGES:
            raise BagError(f"storage must be one of {', '.join(STORAGES)}, got {storage!r}")
        if path.exists() or path.is_symlink():
            raise BagError(f"{path} exists already and is not overwritten")
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
            self.folder = self._folder / (name or path.name)
            self._writer = Writer(self.folder, version=9, storage_plugin=STORAGES[storage])
            if compressed:
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except (OSError, sqlite3.Error) as error:
            raise BagError(f"cannot write recording {path}: {error}") from error
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()

    def write(self, raw: Raw) -> None:
        """Append a message as its bytes, such as a raw subscription of rclpy gives.

        Raises:
            BagError: The topic has another type already, the type is neither a standard one nor
                defined by the message, or the disk cannot be written.
        """
        connection = self._connections.get(raw.topic)
        try:
            if connection is None:
                try:
                    store = typestore_with(raw.type, raw.definition)
                except BagError as error:
                    raise BagError(f"topic {raw.topic}: {error}") from error
                connection = self._writer.add_connection(raw.topic, raw.type, typestore=store)
                self._connections[raw.topic] = connection
            elif connection.msgtype != raw.type:
                raise BagError(
                    f"topic {raw.topic} has type {connection.msgtype}, cannot take {raw.type}"
                )
            self._writer.write(connection, raw.time_ns, raw.data)
        except (OSError, sqlite3.Error) as error:
            raise BagError(f"cannot write recording {self.path}: {error}") from error

    def close(self) -> None:
        """Complete the recording and give it its name.

        Raises:
            BagError: The disk cannot be written, or the name has been taken in the meantime.
        """
        try:
            self._writer.close()
            if self.path.exists():
                raise BagError(f"{self.path} exists already and is not overwritten")
            self.folder.rename(self.path)
        except (OSError, sqlite3.Error) as error:
            raise BagError(f"cannot write recording {self.path}: {error}") from error
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def abandon(self) -> None:
        """Remove the recording and all that has been written of it."""
        self._writer.abort()
        shutil.rmtree(self._folder, ignore_errors=True)
