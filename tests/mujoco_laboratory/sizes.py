"""How large effects are, from just detectable to large.

Just detectable: what a prototype with markers of 1 mm and plates of 2 N found in at least half the sessions; large:
ten to twenty times that, or as much as happens in laboratories.
"""

LEVELS = {"small": 0.0, "medium": 0.5, "large": 1.0}
FIT, HELDOUT = ("squats", "arms", "trunk", "sway", "pushes"), ("mix", "lively")
SIZES: dict[str, dict[str, tuple[float, float]]] = {
    "time_offset": {"lag_s": (0.001, 0.015)},
    "body_lag": {"lag_s": (0.001, 0.008)},
    "filter_lag": {"cutoff_hz": (8.0, 2.5)},
    "plate_gain": {"gain": (0.0015, 0.03)},
    "plate_offset": {"force_plate_N": (1.0, 20.0), "moment_plate_Nm": (0.2, 4.0)},
    "plate_drift": {"rate_plate": (0.06, 1.0)},
    "plate_pose": {"shift_m": (0.001, 0.020), "rotation_rad": (0.0035, 0.05)},
    "plate_crosstalk": {"matrix_plate": (0.0025, 0.04)},
    "plate_assignment": {},
    "gravity_tilt": {"tilt_rad": (0.001, 0.02)},
    "body_mass": {"excess_kg": (0.9, 9.0)},
    "payload": {"mass_kg": (1.0, 15.0)},
    "grasped_object": {"mass_kg": (0.3, 5.0)},
    "unmeasured_contact": {"force_N": (3.0, 60.0)},
    "external_force": {"force_N": (2.0, 40.0)},
    "body_weight_support": {"force_N": (10.0, 200.0)},
    "tether": {"stiffness_N_m": (3.0, 60.0)},
    "drag": {"coefficient_Ns_m": (3.0, 50.0)},
    "wobbling_mass": {"mass_kg": (1.0, 5.0)},
    "flywheel": {"momentum_seg_Nms": (0.3, 6.0)},
    "moving_ground": {"rms_m_s2": (0.02, 0.4)},
    "marker_shift": {"shift_seg_m": (0.003, 0.04)},
    "marker_swap": {"duration_s": (0.2, 3.0)},
    "marker_scale": {"scale": (0.005, 0.06)},
    "soft_tissue": {"shift_90_m": (0.002, 0.03)},
    "skin_lag": {"shift_1g_m": (0.001, 0.008)},
    "missing_dof": {"range_rad": (0.03, 0.35), "range_m": (0.003, 0.03)},
    "joint_centre_shift": {"shift_90_seg_m": (0.002, 0.03)},
    "offcat_water": {"coefficient_Ns2_m2": (1.5, 25.0)},
    "offcat_magnet": {"force_N": (2.0, 40.0)},
    "offcat_inner_motion": {"amplitude_m": (0.004, 0.05)},
    "offcat_motor": {"force_N": (2.0, 40.0)},
    "offcat_hysteresis": {"loop_N": (1.0, 15.0)},
    "offcat_saturation": {"limit_part": (0.62, 0.47)},
}
"""Just detectable and large, of each main parameter; a gain's and a scale's distance from one."""
