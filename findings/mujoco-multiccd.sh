#!/usr/bin/env bash
# MuJoCo 4.0.0: pairs of convex geoms have several contacts by default. A cylinder on a box has one in 3.3; in 4.0 it has two
# where it lies and four where it stands, and one again with the flag multiccd disabled. Exits with 1 if that changes.
#
# Output seen:
#   mujoco 3.3.7: contacts of a cylinder on a box, lying and standing: [1, 1]
#   mujoco 4.0.0: contacts of a cylinder on a box, lying and standing: [2, 4]
#     with <flag multiccd="disable"/>: [1, 1]
source "$(dirname "$0")/lib.bash"
cat >"$work/cylinder.py" <<'PY'
import sys

import mujoco


def contacts(turn, height, flag=""):
    """Number of contacts of a cylinder on a box, 100 um deep."""
    text = f"""<mujoco><option>{flag}</option><worldbody><geom type="box" size=".02 .02 .01" pos="0 0 -.01"/>
      <body pos="0 0 {height - 1e-4}" euler="{turn} 0 0"><freejoint/><geom type="cylinder" size=".01 .015"/></body>
      </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data.ncon


found = [contacts(90, 0.01), contacts(0, 0.015)]
print(f"mujoco {mujoco.__version__}: contacts of a cylinder on a box, lying and standing: {found}")
if mujoco.__version__ == "4.0.0":
    off = '<flag multiccd="disable"/>'
    without = [contacts(90, 0.01, off), contacts(0, 0.015, off)]
    print(f"  with {off}: {without}")
    sys.exit(not (found == [2, 4] and without == [1, 1]))
sys.exit(found != [1, 1])
PY
in_environment mujoco==3.3.7 numpy==2.4.6 <"$work/cylinder.py"
in_environment mujoco==4.0.0 numpy==2.4.6 <"$work/cylinder.py"
