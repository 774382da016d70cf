"""Generate `protocol/generated/`: `python -m trimtab.protocol.generate [folder]`.

pymavlink's mavgen makes the dialect module from `dialect/trimtab.xml`. What its messages set up in each
object then moves into their classes, so that messages are made faster. `frames.py`, the table that finds
messages in a byte stream, comes from the same file. grpcio-tools makes `*_pb2.py` from `log/*.proto`. Only
this script needs the two generators; Trimtab itself needs only the generated files.
"""

from __future__ import annotations

import contextlib
import io
import re
import sys
from pathlib import Path

ROOT = Path(__file__).parent
DIALECT = ROOT / "dialect" / "trimtab.xml"
PROTOS = ROOT / "log"
GENERATED = ROOT / "generated"

_INIT = '"""Made by `python -m trimtab.protocol.generate`; not edited by hand."""\n'

_FRAMES = '''"""What finds messages in a byte stream. Made by `python -m trimtab.protocol.generate`."""

DIALECT_VERSION = {version}

# id: (name, checksum seed, longest payload in bytes)
MESSAGES: dict[int, tuple[str, int, int]] = {{
{rows}}}
'''

_SETUP = (
    r"^        MAVLink_message\.__init__\(self, MAVLink_\w+\.id, .*\n(?:        self\._\w+ = MAVLink_.*\n){3}"
)
_LAST_FIELD = r"^    instance_offset = .*\n(?=\n    def __init__\(self, (?!msgId))"
_DEFAULTS = r"""\g<0>    _type, _fieldnames = msgname, fieldnames
    _instance_field, _instance_offset = instance_field, instance_offset
"""
_BASE = r"^    def __init__\(self, msgId: int, name: str\) -> None:$"
_BASE_DEFAULTS = """    _link_id = _instances = None
    _msgbuf: Union[bytes, bytearray] = b""
    _signed = False

    @cached_property
    def _header(self) -> MAVLink_header:
        if not self._msgbuf:
            return MAVLink_header(type(self).id)
        length, incompatible, compatible, sequence, system, component = self._msgbuf[1:7]
        return MAVLink_header(type(self).id, incompatible, compatible, length, sequence, system, component)

    @cached_property
    def _payload(self) -> Optional[Union[bytes, bytearray]]:
        return self._msgbuf[10 : 10 + self._msgbuf[1]] if self._msgbuf else None

    @cached_property
    def _crc(self) -> Optional[int]:
        end = 10 + self._msgbuf[1] if self._msgbuf else 0
        return self._msgbuf[end] | self._msgbuf[end + 1] << 8 if end else None

    def __init__(self, msgId: int, name: str) -> None:"""
_IMPORT = r"^from builtins import object, range$"
_EDITS = (
    (_SETUP, ""),
    (_LAST_FIELD, _DEFAULTS),
    (_BASE, _BASE_DEFAULTS),
    (_IMPORT, "from builtins import object, range\nfrom functools import cached_property"),
)
"""Patterns of lines in mavgen's module, and what replaces them."""


def generate(folder: Path = GENERATED) -> list[Path]:
    """Write the generated files into `folder` and return their paths. The output is reproducible."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "__init__.py").write_text(_INIT, encoding="utf-8")
    _write_dialect(folder)
    _write_frames(folder)
    _write_protos(folder)
    return sorted(path for path in folder.iterdir() if path.suffix in (".py", ".pyi"))


def _write_dialect(folder: Path) -> None:
    from pymavlink.generator import mavgen  # the generator, not the codec

    output = folder / "trimtab.py"
    options = mavgen.Opts(str(output), wire_protocol="2.0", language="Python3", validate=True)
    output_text = io.StringIO()
    with contextlib.redirect_stdout(output_text):
        succeeded = mavgen.mavgen(options, [str(DIALECT)])
    if not succeeded:
        raise RuntimeError(f"mavgen rejected {DIALECT.name}:\n{output_text.getvalue()}")
    output.write_text(_with_class_defaults(output.read_text(encoding="utf-8")), encoding="utf-8")


def _with_class_defaults(text: str) -> str:
    """Return the dialect module with the common attributes of messages in their classes.

    A message that was received has its bytes; header, payload and checksum are read from them when asked for.
    """
    for pattern, replacement in _EDITS:
        text, count = re.subn(pattern, replacement, text, flags=re.MULTILINE)
        if not count:
            raise RuntimeError(f"mavgen writes messages in another form: {pattern!r} is not found")
    return text


def _write_frames(folder: Path) -> None:
    from pymavlink.generator import mavparse

    xml = mavparse.MAVXML(str(DIALECT), mavparse.PROTOCOL_2_0)
    version = re.search(r"<dialect>(\d+)</dialect>", DIALECT.read_text(encoding="utf-8"))
    if version is None:
        raise RuntimeError(f"{DIALECT.name} states no <dialect> version")
    rows = "".join(
        f'    {message.id}: ("{message.name}", {message.crc_extra}, {message.wire_length}),\n'
        for message in sorted(xml.message, key=lambda message: message.id)
    )
    text = _FRAMES.format(version=version[1], rows=rows)
    (folder / "frames.py").write_text(text, encoding="utf-8")


def _write_protos(folder: Path) -> None:
    import grpc_tools
    from grpc_tools import protoc

    protos = sorted(path.name for path in PROTOS.glob("*.proto"))
    if not protos:
        return
    include = Path(grpc_tools.__file__).parent / "_proto"
    options = [f"-I{PROTOS}", f"-I{include}", f"--python_out={folder}", f"--pyi_out={folder}"]
    if protoc.main(["protoc", *options, *protos]) != 0:
        raise RuntimeError("protoc rejected the schemas of the flight log")


if __name__ == "__main__":
    for written in generate(Path(sys.argv[1]) if len(sys.argv) > 1 else GENERATED):
        print(written.name)
