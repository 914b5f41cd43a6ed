"""What to record so that an effect shows for itself, or two of them can be told apart."""

RECORD = {
    "time_offset": "a jump or a stamp, which marks one instant in markers and forces alike",
    "filter_lag": "a quick motion (a stamp, a shaken arm) with the cameras' own filter switched off",
    "plate_gain": "a known weight laid on each plate in turn",
    "plate_offset": "two seconds of every plate unloaded before and after each trial",
    "plate_drift": "a minute of every plate unloaded, without zeroing it",
    "plate_pose": "a pole with markers pressed on known points of the plate",
    "plate_crosstalk": "a known weight at the centre and at the corners of the plate, and a pole pressed slantwise",
    "plate_assignment": "a step on one plate at a time, called out",
    "gravity_tilt": "a plumb line with two markers, or a spirit level on the calibration frame",
    "moving_ground": "a dead weight resting on a plate while nobody is in the laboratory",
    "body_mass": "the person standing still, weighed on another scale",
    "payload": "the same motion with the load taken off, and quiet standing with and without it",
    "grasped_object": "the same motion with empty hands, and the object weighed",
    "wobbling_mass": "quick stops and heel drops, which let soft mass ring on",
    "flywheel": "turns of the trunk about all three axes with the device switched off and on",
    "unmeasured_contact": "the same motion with rails, seats and boxes out of reach and both feet on plates",
    "external_force": "quiet standing with and without whatever may pull at the person",
    "body_weight_support": "quiet standing with the harness slack and with it tight",
    "tether": "slow leaning to all sides, far from and near to where the spring is fixed",
    "drag": "the same motion twice, slowly and as fast as possible",
    "marker_shift": "a static trial before and after; look whether the marker was stuck on again",
    "marker_swap": "the labels of these frames, checked by eye",
    "marker_scale": "the calibration wand measured with a ruler and recorded once more",
    "soft_tissue": "slow motion of the neighbouring joint alone, with more markers on the segment",
    "skin_lag": "the same motion slowly, and with markers on pins or tight wraps",
    "joint_centre_shift": "the joint bent slowly through its whole range with the limb unloaded",
    "missing_dof": "the joint moved slowly about each of its axes, one at a time",
}
"""What shows an effect for itself."""

APART = {
    frozenset(pair): record
    for *pair, record in (
        ("body_mass", "plate_gain", "the person on a second scale, or a known weight on each plate"),
        ("body_mass", "payload", "quiet standing with the load taken off, and the load on a scale"),
        ("payload", "plate_gain", "a known weight on each plate, and quiet standing with the load taken off"),
        ("body_mass", "body_weight_support", "quiet standing with the harness slack"),
        ("body_weight_support", "plate_gain", "a known weight on each plate, and quiet standing without the harness"),
        ("body_weight_support", "external_force", "quiet standing without the harness"),
        ("body_weight_support", "payload", "quick squats and hops: a load resists acceleration, a harness does not"),
        ("body_mass", "external_force", "quick squats and hops: mass resists acceleration, a constant force does not"),
        ("payload", "external_force", "quick squats and hops: a load resists acceleration, a constant force does not"),
        ("drag", "time_offset", "a jump or a stamp: a wrong clock shows at the impact, a drag does not"),
        ("filter_lag", "time_offset", "a jump or a stamp: a filter blunts the impact, a wrong clock only shifts it"),
        ("filter_lag", "wobbling_mass", "a stamp with a heavy rigid tool: it has no soft mass, but passes the filter"),
        ("filter_lag", "drag", "slow and quick motion: a drag shows at low speed too"),
        ("plate_crosstalk", "plate_pose", "a pole pressed, upright and slantwise, on known points of the plate"),
        ("gravity_tilt", "plate_pose", "a dead weight on each plate: gravity alone must leave no horizontal force"),
        ("gravity_tilt", "tether", "standing at several places of the room: a spring pulls differently there"),
        ("gravity_tilt", "external_force", "standing at several places of the room, with and without an extra load"),
        ("external_force", "tether", "slow leaning to all sides: a spring's force changes, a constant one does not"),
        ("external_force", "unmeasured_contact", "quiet standing in the middle of the plates, nothing else in reach"),
        ("external_force", "plate_offset", "every plate unloaded for two seconds"),
        ("plate_drift", "plate_offset", "every plate unloaded for a minute"),
        ("plate_assignment", "plate_pose", "a step on one plate at a time, called out"),
        ("grasped_object", "unmeasured_contact", "the object moved up and down quickly in the hand: only mass resists"),
        ("grasped_object", "payload", "the same motion with empty hands"),
        ("moving_ground", "unmeasured_contact", "a dead weight resting on a plate while nobody is near"),
        ("marker_shift", "soft_tissue", "a static trial before and after: what was knocked stays displaced at rest"),
        ("soft_tissue", "wobbling_mass", "the same motion slowly and quickly: skin slides at any speed"),
        ("skin_lag", "soft_tissue", "the same motion slowly and quickly: skin slides at any speed"),
        ("skin_lag", "wobbling_mass", "heel drops: soft mass rings on in the forces, flesh in the markers alone"),
        ("filter_lag", "skin_lag", "a stamp with markers on something rigid: it has no flesh, but passes the filter"),
        ("marker_scale", "skin_lag", "slow motion: a wrong scale shows at any speed"),
        ("joint_centre_shift", "missing_dof", "the joint bent slowly to and fro: what glides returns the same way"),
        ("missing_dof", "soft_tissue", "more markers on both segments, some of them over bone"),
        ("joint_centre_shift", "soft_tissue", "more markers on both segments, some of them over bone"),
        ("payload", "the same motion with the load weighed, and moved to another segment"),
        ("external_force", "leaning and bending, so that the places where the force may act move apart"),
        ("body_weight_support", "bending of the trunk, so that pelvis and thorax move apart"),
        ("tether", "bending and leaning, so that the places where the spring may pull move apart"),
        ("drag", "quick motion of one segment after the other"),
        ("flywheel", "turns of one segment after the other"),
        ("wobbling_mass", "heel drops with the trunk upright and bent"),
        ("time_offset", "a stamp in every trial"),
        ("plate_gain", "a known weight on each plate in turn"),
        ("missing_dof", "each of the two joints moved alone"),
        ("joint_centre_shift", "each of the two joints moved alone"),
        ("soft_tissue", "each of the neighbouring joints moved alone"),
        ("marker_shift", "a static trial before and after each trial"),
    )
}
"""What tells a pair apart; of one name: the same effect at two places."""


def tell_apart(a: str, b: str) -> str:
    """What to record so that effects ``a`` and ``b`` (or two places of one) can be told apart."""
    known = APART.get(frozenset((a, b)))
    return known or " and ".join(RECORD[name] for name in sorted({a, b}))
