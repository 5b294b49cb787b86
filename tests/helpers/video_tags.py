"""Display matrices in MP4 files, as rotated cameras write them."""

import struct


def tag_display(path, matrix):
    """Put a display matrix (a, b, c, d) into the first track of an MP4 file, and return the path of the file.

    ISO 14496-12, box `tkhd` of version 0: the matrix lies 40 bytes behind the name, as nine numbers of 16.16
    bits, the last column 2.30.
    """
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + 40
    a, b, c, d = (round(65536 * value) for value in matrix)
    assert struct.unpack(">9i", data[at : at + 36]) == (65536, 0, 0, 0, 65536, 0, 0, 0, 2**30)
    data[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 2**30)
    path.write_bytes(data)
    return path
