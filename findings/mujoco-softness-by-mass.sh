#!/usr/bin/env bash
# MuJoCo 4.0.0: contacts and equality constraints have no stiffness of their own. Under the same 1 N, a body of 20 g sinks
# 45 times as far into a plane as one of 2 kg, and a weld gives way as far. Exits with 1 if that changes.
#
# Output seen:
#   mujoco 4.0.0: motion under 1 N, um, of 20 g, 200 g, 2 kg
#     into a plane:    1000 211 22
#     against a weld:  1000 211 22
source "$(dirname "$0")/lib.bash"
in_environment mujoco==4.0.0 numpy==2.4.6 <<'PY'
import sys

import mujoco

MASSES_KG = (0.02, 0.2, 2.0)


def motion_um(mass_kg, plane, weld, force, height=0.0):
    """How far a ball moves along `force` (3, N) once it has come to rest."""
    text = f"""<mujoco><option gravity="0 0 0"/><worldbody>{plane}<body name="ball" pos="0 0 {height}"><freejoint/>
      <geom type="sphere" size=".01" mass="{mass_kg}"/></body></worldbody>{weld}</mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    start = data.qpos[:3].copy()
    data.xfrc_applied[1, :3] = force
    for _ in range(3000):
        mujoco.mj_step(model, data)
    return 1e6 * float((data.qpos[:3] - start) @ force)


contact = [motion_um(m, '<geom type="plane" size="1 1 1"/>', "", (0, 0, -1), 0.01) for m in MASSES_KG]
weld = [motion_um(m, "", '<equality><weld body1="ball"/></equality>', (1, 0, 0)) for m in MASSES_KG]
print(f"mujoco {mujoco.__version__}: motion under 1 N, um, of 20 g, 200 g, 2 kg")
print("  into a plane:   ", *(f"{v:.0f}" for v in contact))
print("  against a weld: ", *(f"{v:.0f}" for v in weld))
sys.exit(not all(40 < v[0] / v[2] < 50 for v in (contact, weld)))
PY
