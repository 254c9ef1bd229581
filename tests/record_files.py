"""Record files as other programs write them: objects and structs of MATLAB."""

import struct

import h5py
import numpy as np


def matlab73(path, variables):
    """A version 7.3 file as MATLAB lays it out: structs are groups, elements of struct arrays are in ``#refs#``."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            _put(file, file, name, value)
    text = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Jan  5 10:00:00 2026 HDF5 schema 1.00 ."
    with path.open("r+b") as stream:
        stream.write(text.ljust(116) + bytes(8) + b"\x00\x02IM")
    return path


def _put(file, group, name, value):
    if isinstance(value, dict):
        child = group.create_group(name)
        child.attrs["MATLAB_class"] = np.bytes_("struct")
        for key, item in value.items():
            _put(file, child, key, item)
    elif isinstance(value, list):  # a struct array of dicts with the same fields
        child, refs = group.create_group(name), file.require_group("#refs#")
        child.attrs["MATLAB_class"] = np.bytes_("struct")
        for key in value[0]:
            places = []
            for item in value:
                place = f"r{len(refs)}"
                _put(file, refs, place, item[key])
                places.append(refs[place].ref)
            child.create_dataset(key, data=np.array([places], dtype=object).T, dtype=h5py.ref_dtype)
    elif isinstance(value, str):
        dataset = group.create_dataset(name, data=np.array([[ord(ch)] for ch in value], dtype=np.uint16))
        dataset.attrs["MATLAB_class"] = np.bytes_("char")
        dataset.attrs["MATLAB_int_decode"] = np.int32(2)
    else:
        value = np.atleast_2d(value)
        # Empty arrays are stored as their sizes.
        dataset = group.create_dataset(name, data=value.T if value.size else np.array(value.shape, dtype=np.uint64))
        if not value.size:
            dataset.attrs["MATLAB_empty"] = np.uint8(1)
        dataset.attrs["MATLAB_class"] = np.bytes_("double")


def matlab5_object(path, variable, kind):
    """A version 5 file with one object (``timetable``), as MATLAB keeps it: names, and a key."""

    def element(code, data):
        return struct.pack("<II", code, len(data)) + data + bytes(-len(data) % 8)

    key = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    key += element(6, np.array([0xDD000000, 2, 1, 1, 1, 1], "<u4").tobytes())
    names = b"".join(element(1, text.encode()) for text in (variable, "MCOS", kind))
    body = element(6, struct.pack("<II", 17, 0)) + names + element(14, key)
    head = b"MATLAB 5.0 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x01IM"
    path.write_bytes(head + element(14, body))
    return path
