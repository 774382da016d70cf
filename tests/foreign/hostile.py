"""Files that are small, or sparse on disk, and exhaust memory or time where sizes are not checked first."""

from __future__ import annotations

import hashlib
import struct
import zipfile
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import zstandard

from tests.foreign import dataflash, ulog, usd
from trimtab.host.log.mcap_file import MAGIC

MIB = 1 << 20


def sparse(path: Path, head: bytes = b"", size: int = 4 << 30) -> Path:
    """A file of 4 GiB that takes no room: `head`, then zeros."""
    with path.open("wb") as file:
        file.write(head)
        file.truncate(size)
    return path


def weights(path: Path, count: int, zeros_mib: int) -> Path:
    """An archive of weights, whose array declares `count` numbers and goes on with so many MiB of zeros."""
    head = BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (count,)})
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    start = packer.compress(head.getvalue()) + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(MIB)) + packer.flush(zlib.Z_FULL_FLUSH)
    body = start + block * zeros_mib + packer.flush()
    size, crc = len(head.getvalue()) + MIB * zeros_mib, zlib.crc32(head.getvalue())
    for _ in range(zeros_mib):
        crc = zlib.crc32(bytes(MIB), crc)
    name = b"xi.npy"
    fields = struct.pack("<HHHIII", 8, 0, 0, crc, len(body), size)
    local = b"PK\3\4" + struct.pack("<HH", 20, 0) + fields + struct.pack("<HH", len(name), 0) + name
    central = b"PK\1\2" + struct.pack("<HHH", 20, 20, 0) + fields
    central += struct.pack("<HHHHHII", len(name), 0, 0, 0, 0, 0, 0) + name
    end = b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, 1, 1, len(central), len(local) + len(body), 0)
    path.write_bytes(local + body + central + end)
    assert zipfile.ZipFile(path).getinfo("xi.npy").file_size == size
    return path


def _record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def log_of_chunks(log: bytes, count: int, content: bytes) -> bytes:
    """A flight log with so many more chunks of this content, which its index does not name."""
    frame = zstandard.ZstdCompressor().compress(content)
    head = struct.pack("<QQQI", 0, 0, len(content), 0) + struct.pack("<I", 4) + b"zstd"
    chunk = _record(6, head + struct.pack("<Q", len(frame)) + frame)
    (summary_start,) = struct.unpack_from("<Q", log, len(log) - len(MAGIC) - 20)
    end = summary_start - len(_record(15, bytes(4)))
    return log[:end] + chunk * count + log[end:]


def messages(count: int, size: int) -> bytes:
    """Records of so many messages of the first channel, of so many bytes."""
    return _record(5, struct.pack("<HIQQ", 1, 0, 0, 0) + bytes(size)) * count


def bag_of_chunks(path: Path, frames: int) -> Path:
    """A rosbag in MCAP without an index, whose one chunk has so many frames of 32 MiB of zeros."""
    frame = zstandard.ZstdCompressor().compress(bytes(32 * MIB)) * frames
    head = struct.pack("<QQQI", 0, 0, 32 * MIB * frames, 0) + struct.pack("<I", 4) + b"zstd"
    profile = struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0)
    data = MAGIC + _record(1, profile) + _record(6, head + struct.pack("<Q", len(frame)) + frame)
    path.write_bytes(data + _record(15, bytes(4)) + _record(2, bytes(20)) + MAGIC)
    return path


def nested_ulog(levels: int, length: int) -> bytes:
    """A ULog of one topic, whose arrays of formats are inside each other."""
    data = ulog.MAGIC + b"\x01" + struct.pack("<Q", 0) + ulog.message("B", bytes(40))
    for level in range(levels):
        data += ulog.message("F", f"f{level}:f{level + 1}[{length}] x;".encode())
    data += ulog.message("F", f"f{levels}:uint64_t timestamp;".encode())
    return data + ulog.message("A", struct.pack("<BH", 0, 0) + b"f0") + ulog.message("D", bytes(10))


def tiny_messages(count: int) -> bytes:
    """A DataFlash log of messages without content."""
    layout = struct.pack("<BB4s16s64s", 1, 3, b"XKF1", b"", b"")
    return dataflash.definitions()[:89] + b"\xa3\x95\x80" + layout + b"\xa3\x95\x01" * count


def tiny_records(count: int) -> bytes:
    """A Crazyflie uSD log of records without variables."""
    body = struct.pack("<BHH", 0xBC, 1, 1) + struct.pack("<H", 7) + b"e\0" + struct.pack("<H", 0)
    return usd.with_sum(body + struct.pack("<HI", 7, 0) * count)


def ros1_bag(compress: Callable[[bytes], bytes], compression: str, message: bytes, definition: str) -> bytes:
    """A bag of ROS 1 with one message of the type geometry_msgs/PoseStamped, defined as given."""

    def fields(**values: bytes) -> bytes:
        made = [name.encode() + b"=" + value for name, value in values.items()]
        return b"".join(struct.pack("<I", len(one)) + one for one in made)

    def record(data: bytes, **values: bytes) -> bytes:
        head = fields(**values)
        return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data

    one, zero = struct.pack("<I", 1), bytes(4)
    content = record(message, op=b"\2", conn=zero, time=bytes(8))
    start = b"#ROSBAG V2.0\n"
    chunk = record(
        compress(content), op=b"\5", compression=compression.encode(), size=struct.pack("<I", len(content))
    )
    chunk += record(bytes(12), op=b"\4", ver=one, conn=zero, count=one)
    digest = hashlib.md5(definition.strip().encode()).hexdigest().encode()
    pose = {"topic": b"/pose", "type": b"geometry_msgs/PoseStamped", "md5sum": digest}
    index = record(
        fields(**pose, message_definition=definition.encode()), op=b"\7", conn=zero, topic=b"/pose"
    )
    at = len(start) + 4096
    index += record(
        zero + one, op=b"\6", ver=one, chunk_pos=struct.pack("<Q", at), start_time=bytes(8),
        end_time=bytes(8), count=one,
    )  # fmt: skip
    counts = {"index_pos": struct.pack("<Q", at + len(chunk)), "conn_count": one, "chunk_count": one}
    first = record(b"", op=b"\3", **counts)
    padding = 4096 - len(first)
    return start + first[:-4] + struct.pack("<I", padding) + bytes(padding) + chunk + index
