"""What all messages have in CDR: their beginning, and strings."""

#: CDR, little-endian; alignment counts from behind it.
ENCAPSULATION = b"\x00\x01\x00\x00"


def encoded_text(text: str) -> bytes:
    """A string: its length with the zero at its end, and both."""
    data = text.encode() + b"\0"
    return len(data).to_bytes(4, "little") + data


def decoded_text(data: bytes) -> str | None:
    """The text of a string's bytes behind the length.

    None where they do not end with their only zero or are not UTF-8.
    """
    if not data or data.find(b"\0") != len(data) - 1:
        return None
    try:
        return data[:-1].decode()
    except UnicodeDecodeError:
        return None
