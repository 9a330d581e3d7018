#!/usr/bin/env bash
# MuJoCo up to 3.3: every contact of two boxes has half of the true overlap; a box on a plane has all of it, and so have two
# boxes in 4.0. Exits with 1 if that changes.
#
# Output seen:
#   mujoco 3.3.7: 100 um of overlap; box on box [50.0, 50.0, 50.0, 50.0], box on plane [100.0, 100.0, 100.0, 100.0]
#   mujoco 4.0.0: 100 um of overlap; box on box [100.0, 100.0, 100.0, 100.0], box on plane [100.0, 100.0, 100.0, 100.0]
source "$(dirname "$0")/lib.bash"
cat >"$work/boxes.py" <<'PY'
import sys

import mujoco

OVERLAP_M = 1e-4


def depths_um(support, height):
    """Depths of a box of 20 mm that stands on `support`, OVERLAP_M deep."""
    text = f"""<mujoco><worldbody><geom {support}/><body pos="0 0 {height - OVERLAP_M}"><freejoint/>
      <geom type="box" size=".01 .01 .01"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return [round(-1e6 * float(data.contact[i].dist), 1) for i in range(data.ncon)]


boxes = depths_um('type="box" size=".02 .02 .02" pos="0 0 -.02"', 0.01)
plane = depths_um('type="plane" size="1 1 1"', 0.01)
print(f"mujoco {mujoco.__version__}: 100 um of overlap; box on box {boxes}, box on plane {plane}")
wanted = 100 if mujoco.__version__ == "4.0.0" else 50
sys.exit(not (set(boxes) == {wanted} and set(plane) == {100}))
PY
in_environment mujoco==3.3.7 numpy==2.4.6 <"$work/boxes.py"
in_environment mujoco==4.0.0 numpy==2.4.6 <"$work/boxes.py"
