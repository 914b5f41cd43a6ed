"""The elements of OpenSim files that the reader looks into, and what may stand in them.

Cited. Properties that OpenSim 4 lists of its classes (``Object::getPropertyByIndex``) and those of older versions that
it renames on reading (``updateFromXMLNode`` of Body, Joint, Coordinate, Constraint and Marker).
"""

from torchid.model.markup import Vocabulary
from torchid.model.opensim.function_elements import READERS
from torchid.model.opensim.joints import KINDS

JOINTS = ("CustomJoint", *KINDS)
CONSTRAINTS = (
    "CoordinateCouplerConstraint", "ConstantDistanceConstraint", "PointConstraint", "PointOnLineConstraint",
    "RollingOnSurfaceConstraint", "WeldConstraint",
)  # fmt: skip
_LOOKS = "FrameGeometry attached_geometry WrapObjectSet VisibleObject frame_geometry"
_JOINT = (
    "socket_parent_frame socket_child_frame coordinates frames components parent_body location_in_parent "
    "orientation_in_parent location orientation location_in_child orientation_in_child CoordinateSet reverse"
)
_FUNCTIONS = " ".join(READERS)
_POINTS = dict.fromkeys(
    ("SimmSpline", "NaturalCubicSpline", "natCubicSpline", "PiecewiseLinearFunction"), ("name", "x y")
)

WORDS: Vocabulary = {
    "Model": (
        "name",
        "Ground gravity credits publications length_units force_units assembly_accuracy components frames defaults "
        "BodySet JointSet ConstraintSet MarkerSet ForceSet ControllerSet ContactGeometrySet ProbeSet ComponentSet "
        "ModelVisualPreferences CoordinateSet AnalysisSet",
    ),
    **dict.fromkeys(("BodySet", "JointSet", "ConstraintSet", "MarkerSet", "CoordinateSet"), ("name", "objects groups")),
    "objects": ("", " ".join(f"{tag}*" for tag in ("Body", "Marker", "Coordinate", *JOINTS, *CONSTRAINTS))),
    "Body": (
        "name",
        f"mass mass_center inertia inertia_xx inertia_yy inertia_zz inertia_xy inertia_xz inertia_yz Joint components "
        f"{_LOOKS}",
    ),
    "Joint": ("name", " ".join(JOINTS)),
    **{kind: ("name", f"{_JOINT} SpatialTransform" if kind == "CustomJoint" else _JOINT) for kind in JOINTS},
    "coordinates": ("", "Coordinate*"),
    "Coordinate": (
        "name",
        "default_value default_speed_value range clamped locked prescribed prescribed_function "
        "is_free_to_satisfy_constraints components motion_type initial_value",
    ),
    "frames": ("", "PhysicalOffsetFrame*"),
    "PhysicalOffsetFrame": ("name", f"socket_parent translation orientation components {_LOOKS}"),
    "SpatialTransform": ("name", "TransformAxis*"),
    "TransformAxis": ("name", f"coordinates axis function {_FUNCTIONS}"),
    "CoordinateCouplerConstraint": (
        "name",
        "isEnforced isDisabled coupled_coordinates_function independent_coordinate_names dependent_coordinate_name "
        "scale_factor components",
    ),
    "coupled_coordinates_function": ("", _FUNCTIONS),
    "function": ("", _FUNCTIONS),
    "Marker": ("name", f"socket_parent_frame body location fixed components {_LOOKS}"),
    "Constant": ("name", "value"),
    "LinearFunction": ("name", "coefficients"),
    "PolynomialFunction": ("name", "coefficients"),
    "MultiplierFunction": ("name", "function scale"),
    "Sine": ("name", "amplitude omega phase offset"),
    **_POINTS,
}
