"""Record files as other programs write them: bags of ROS 2 through mcap's writer, objects and structs of MATLAB."""

import io
import struct

import h5py
import numpy as np

T0 = 1_700_000_000_000_000_000  # ns
LINE = "=" * 80
HEADER = f"""
{LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
JOINTS = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort" + HEADER
WRENCH = (
    f"geometry_msgs/Vector3 force\nbool valid\nstring note\n{LINE}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\n"
)
TYPES = {
    "joints": ("sensor_msgs/msg/JointState", JOINTS),
    "number": ("std_msgs/msg/Float64", "float64 data\n"),
    "wrench": ("my_msgs/msg/Wrench", WRENCH),
}


def joints(stamp, position, names=("a", "b"), frame="base"):
    """A JointState; ``stamp`` in ns."""
    header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": frame}
    return {"header": header, "name": list(names), "position": list(position), "velocity": [], "effort": []}


def bag(path, events, **options):
    """Write (topic, type, log time in ns, message) in this order."""
    from mcap.writer import Writer as McapWriter
    from mcap_ros2.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(io.BytesIO())
        writer._writer = McapWriter(stream, **options)  # the ROS writer hands on no options
        writer._writer.start(profile="ros2")
        schemas = {}
        for topic, kind, log, message in events:
            if kind not in schemas:
                schemas[kind] = writer.register_msgdef(*TYPES[kind])
            writer.write_message(topic, schemas[kind], message, log, log)
        writer.finish()
    return path


def matlab73(path, variables):
    """A version 7.3 file as MATLAB lays it out: structs are groups, elements of struct arrays lie in ``#refs#``."""
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
        group.create_dataset(name, data=np.atleast_2d(value).T).attrs["MATLAB_class"] = np.bytes_("double")


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
