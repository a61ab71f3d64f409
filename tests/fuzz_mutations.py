"""Mutations of a sound file's bytes, for `fuzz_readers`: of any file, of text, and of formats' own parts."""

import copy
import hashlib
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

Draws = np.random.Generator
Mutation = Callable[[bytes, Draws], bytes]

ODD_NUMBERS = [0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1]
ODD_WORDS = ["0", "-1", "1e999", "-1e999", "nan", "inf", "1e300", "1e-320", "1e5000", "4294967296", "0x10"]
ODD_WORDS += ["9223372036854775808", "9" * 5000, "x", "/", "..", "é", "\0", "", "../../x.png", "/etc/passwd"]
ODD_VALUES: list[Any] = [None, True, -1, 0, 0.5, 1e308, 2**40, 10**400, "", "x", "../../x", [], {}, [[]]]
ODD_VALUES += [{"#same": 0, "#count": 2**40}, {"#same": {"#same": 0, "#count": 10**6}, "#count": 10**6}]


def mutate_bytes(data: bytes, draws: Draws) -> bytes:
    """Return `data` with one to three changes: bits, bytes, numbers, cut, repeated, or swapped pieces."""
    for _ in range(draws.integers(1, 4)):
        place, length = (int(draws.integers(0, len(data) + 1)) for _ in range(2))
        end = place + min(length, int(draws.integers(1, 64)))
        match draws.integers(7):
            case 0:
                bit = 1 << int(draws.integers(8))
                flipped = bytes(byte ^ bit for byte in data[place : place + 1])
                data = data[:place] + flipped + data[place + 1 :]
            case 1:
                data = data[:place] + draws.bytes(end - place) + data[end:]
            case 2:
                number = ODD_NUMBERS[draws.integers(len(ODD_NUMBERS))]
                width = int(draws.choice([1, 2, 4, 8]))
                data = data[:place] + number.to_bytes(8, "little")[:width] + data[place + width :]
            case 3:
                data = data[:place]
            case 4:
                data = data[:place] + data[end:]
            case 5:
                data = data[:end] + data[place:]
            case 6:
                data = data[:place] + bytes(end - place) + data[end:]
    return data


def mutate_words(data: bytes, draws: Draws) -> bytes:
    """Return a text with one to three of its words replaced by odd ones, or lines left out."""
    lines = [line.split(" ") for line in data.decode("latin-1").split("\n")]
    for _ in range(draws.integers(1, 4)):
        line = lines[draws.integers(len(lines))]
        line[draws.integers(len(line))] = ODD_WORDS[draws.integers(len(ODD_WORDS))]
        if draws.integers(6) == 0 and len(lines) > 1:
            lines.pop(int(draws.integers(len(lines))))
    return "\n".join(" ".join(line) for line in lines).encode("utf-8")


def mutate_json(data: bytes, draws: Draws) -> bytes:
    """Return a JSON text with one to three of its values replaced, left out or nested without end."""
    if draws.integers(40) == 0:
        return b"[" * 100_000
    value = [json.loads(data)]
    for _ in range(draws.integers(1, 4)):
        holder: Any = value
        while True:
            keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
            key = keys[draws.integers(len(keys))]
            inner = holder[key]
            if not (isinstance(inner, (dict, list)) and inner) or draws.integers(4) == 0:
                break
            holder = inner
        if draws.integers(5) == 0 and holder is not value:
            del holder[key]
        else:
            holder[key] = copy.deepcopy(ODD_VALUES[draws.integers(len(ODD_VALUES))])
    return json.dumps(value[0]).encode().replace(b"1e+308", b"1e999")


def mutate_zip(data: bytes, draws: Draws) -> bytes:
    """Return a zip archive with right checksums, in which one member's bytes were mutated."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = list(members)[draws.integers(len(members))]
    head = 128 if draws.integers(2) else len(members[name])  # an array's header, or anywhere
    members[name] = mutate_bytes(members[name][:head], draws) + members[name][head:]
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, content in members.items():
            archive.writestr(each, content)
    return packed.getvalue()


def mutate_png(data: bytes, draws: Draws) -> bytes:
    """Return a PNG in which one chunk was mutated and has a right checksum."""
    chunks, place = [], 8
    while place < len(data):
        length = int.from_bytes(data[place : place + 4], "big")
        chunks.append([data[place + 4 : place + 8], data[place + 8 : place + 8 + length]])
        place += 12 + length
    chunk = chunks[draws.integers(len(chunks))]
    chunk[1] = mutate_bytes(chunk[1], draws)
    packed = (struct.pack(">I", len(b)) + a + b + struct.pack(">I", zlib.crc32(a + b)) for a, b in chunks)
    return data[:8] + b"".join(packed)


def mutate_glb(data: bytes, draws: Draws) -> bytes:
    """Return a GLB whose JSON part was mutated, its lengths being right."""
    length = int.from_bytes(data[12:16], "little")
    text = mutate_json(data[20 : 20 + length], draws)
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    return data[:8] + struct.pack("<III", 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


def mutate_sealed(data: bytes, draws: Draws) -> bytes:
    """Return a checkpoint whose content was mutated and has a right digest."""
    head, _, content = data.partition(b"\n")
    content = mutate_zip(content, draws)
    return head[:-64] + hashlib.sha256(content).hexdigest().encode() + b"\n" + content
