#!/usr/bin/env bash
# rosbags 0.11.9: a JointState whose positions are an array of whole numbers (NumPy's int64) is written without a word, and
# read back as their bits taken for float64; float32 is refused. Exits with 1 if that changes.
#
# Output seen:
#   rosbags 0.11.9: positions [ 0  1 -1] as int64 are read as [0.e+000 5.e-324     nan]; as float32: ValueError
source "$(dirname "$0")/lib.bash"
in_environment rosbags==0.11.9 numpy==2.4.6 <<'PY'
import sys
from importlib.metadata import version

import numpy as np
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
types, name = store.types, "sensor_msgs/msg/JointState"
header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 0), "palm")


def written_and_read(position):
    message = types[name](header, ["a", "b", "c"], position, np.zeros(0), np.zeros(0))
    return store.deserialize_cdr(store.serialize_cdr(message, name), name).position


whole = np.array([0, 1, -1])
seen = written_and_read(whole)
try:
    single = f"{written_and_read(whole.astype(np.float32))}"
except Exception as error:
    single = type(error).__name__
print(f"rosbags {version('rosbags')}: positions {whole} as {whole.dtype} are read as {seen}; as float32: {single}")
same = np.array_equal(seen.view(np.int64), whole) and not np.array_equal(seen, whole)
sys.exit(not (same and single == "ValueError"))
PY
