"""Sound configs, marker sets and models as people write them."""

CONFIG = """\
subject: {name: S01, mass_kg: 71.4, height_m: 1.78}
markers: plug_in_gait
trials:
  - {name: stand, file: stand.trc, forces: stand.mot, role: static}
  - {name: walk, file: walk.c3d, role: fit, up: z}
geometry:
  solver: arrow
  iterations: 40
seed: 3
"""

FULL_CONFIG = """\
subject:
  name: "S 02"
  mass_kg: 71.4
  mass_sd_kg: 0.5
  sex: female
model: whole_body
markers: plug_in_gait
trials:
- name: walk
  file: ./walk.c3d
  role: heldout
  units: mm
  allow_truncated: false
  inertia: true
motion: {filter: butterworth, cutoff_hz: 6.5}
inertia:
  known_mass: true
  com_boxes: false
diagnosis:
  enabled: yes please
  max_effects: 2
  exclude: [flywheel, time_offset]
threads: 2
out: ./results
""".replace("yes please", "true")

MARKERS = """\
extends: plug_in_gait
Sternum: thorax
"V.Sacral": pelvis
L.Heel: {segment: foot_l, landmark: heel_l}
R.Heel:
  segment: foot_r
  landmark: heel_r
aliases:
  Sternum: [STRN2, "Sternal notch"]
computed: ["*_CoM", "HJC?"]
"""

_LINK = """\
  <link name="{0}"><inertial><origin xyz="0 0.01 {1}" rpy="0.1 0 -0.2"/><mass value="{2}"/>
    <inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="-0.002" izz="0.025"/></inertial>
    <visual><geometry><sphere radius="0.1"/></geometry></visual></link>
"""
URDF = (
    '<?xml version="1.0"?>\n<robot name="walker">\n  <!-- a trunk and an arm -->\n'
    + _LINK.format("trunk", -0.1, 30.5) + _LINK.format("arm", -0.12, "2.1") + _LINK.format("hand", "-5e-2", 0.6)
    + """\
  <link name="swivel"/>
  <link name="clavicle"/>
  <joint name="s1" type="revolute"><origin xyz="0 0.2 0.45" rpy="0 0 0.3"/><parent link="trunk"/><child link="swivel"/>
    <axis xyz="0 1 0"/><limit lower="-1.5" upper="2.5" effort="100" velocity="10"/></joint>
  <joint name="s2" type="continuous"><parent link="swivel"/><child link="arm"/><axis xyz="0.8 0 0.6"/></joint>
  <joint name="slide" type="prismatic"><origin xyz="0 0 -0.3"/><parent link="arm"/><child link="hand"/>
    <axis xyz="0 0 1"/><limit lower="-0.05" upper="0.05" effort="10" velocity="1"/></joint>
  <joint name="mount" type="fixed"><origin xyz="0.1 0 0.4"/><parent link="trunk"/><child link="clavicle"/></joint>
</robot>
"""
)  # fmt: skip

MJCF = """\
<mujoco model="walker">
  <compiler angle="radian" eulerseq="ZYX"/>
  <option gravity="0 0 -9.81" timestep="0.002"/>
  <default>
    <joint damping="1"/><geom density="1100"/>
    <default class="arm"><joint axis="0 1 0" range="-0.5 1"/><geom type="capsule" size="0.04 0.1"/></default>
  </default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="trunk" pos="0.1 0.2 1.1" quat="0.9 0.1 -0.3 0.2"><freejoint/>
      <geom type="box" size="0.1 0.15 0.2" pos="0 0 0.1" euler="0.1 0 0.2"/>
      <site name="chest" pos="0.1 0 0.2"/>
      <body name="shoulder" pos="0 0.2 0.3" axisangle="1 2 3 0.7">
        <inertial pos="0.01 0.02 -0.1" quat="0.7 0.2 0.1 0.3" mass="2" diaginertia="0.02 0.015 0.01"/>
        <joint name="s1" axis="0 1 0" pos="0.03 0.01 0"/><joint name="s2" axis="1 0 0" pos="0.03 0.01 0"/>
        <body name="forearm" pos="0 0 -0.3" zaxis="0.1 0.2 -1" childclass="arm">
          <joint name="elbow" pos="0 0 0.02"/><geom pos="0 0 0.1" xyaxes="1 0.2 0 0 1 0.1"/>
          <body name="cuff" pos="0 0 0.15"><geom type="sphere" size="0.05"/></body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="elbow" gear="100"/></actuator>
</mujoco>
"""

MJCF_PLAIN = """\
<mujoco>
  <worldbody>
    <body name="a" pos="0 0 1">
      <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.1"/>
      <body name="b" pos="0 0 0.4">
        <joint name="rail" type="slide" axis="0 0.6 -0.8" range="-0.1 0.2"/><joint name="hip" range="-40 120"/>
        <inertial pos="0 0 0.1" mass="1.5" fullinertia="0.02 0.03 0.025 0.001 -0.002 0.003"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
