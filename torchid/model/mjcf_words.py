"""The elements and attributes of MJCF that the reader looks at, as MuJoCo's own schema lists them (mj_printSchema)."""

from torchid.model.markup import Vocabulary

WORDS: Vocabulary = {
    "mujoco": (
        "model",
        "actuator* asset* compiler* contact* custom* default* deformable* equality* extension* include* "
        "keyframe* option* sensor* size* statistic* tendon* visual* worldbody*",
    ),
    "compiler": (
        "alignfree angle assetdir autolimits balanceinertia boundinertia boundmass conflict coordinate "
        "discardvisual eulerseq fitaabb fusestatic inertiafromgeom inertiagrouprange meshdir passthrough "
        "savecanonical savecompiled saveinertial settotalmass strippath texturedir usethread",
        "lengthrange",
    ),
    "option": (
        "actuatorgroupdisable ccd_iterations ccd_tolerance cone density gravity impratio integrator "
        "iterations jacobian ls_iterations ls_tolerance magnetic noslip_iterations noslip_tolerance "
        "o_friction o_margin o_solimp o_solref sdf_initpoints sdf_iterations sleep_tolerance solver timestep "
        "tolerance viscosity wind",
        "flag",
    ),
    "default": (
        "class",
        "adhesion* camera* cylinder* damper* dcmotor* default* equality* general* geom* intvelocity* joint* "
        "light* material* mesh* motor* muscle* orientation* pair* pid* position* site* tendon* texture* "
        "velocity*",
    ),
    "worldbody": (
        "axisangle childclass euler fuse gravcomp mocap name pos quat simple sleep user xyaxes zaxis",
        "attach* body* camera* composite* flexcomp* frame* freejoint* geom* include* inertial* joint* light* "
        "plugin* replicate* site*",
    ),
    "body": (
        "axisangle childclass euler fuse gravcomp mocap name pos quat simple sleep user xyaxes zaxis",
        "attach* body* camera* composite* flexcomp* frame* freejoint geom* include* inertial joint* light* "
        "plugin* replicate* site*",
    ),
    "inertial": (
        "axisangle diaginertia euler fullinertia mass pos quat xyaxes zaxis",
        "",
    ),
    "joint": (
        "actuatorfrclimited actuatorfrcrange actuatorgravcomp armature axis class damping frictionloss group "
        "limited margin name pos range ref solimpfriction solimplimit solreffriction solreflimit springdamper "
        "springref springyield stiffness type user",
        "",
    ),
    "freejoint": (
        "align group name",
        "",
    ),
    "geom": (
        "adhesion axisangle castshadow class conaffinity condim contype density euler fitscale fluidcoef "
        "fluidshape friction fromto gap group hfield margin mass material mesh name pos priority quat rgba "
        "shellinertia size solimp solmix solref surfacevel type user xyaxes zaxis",
        "plugin*",
    ),
    "site": (
        "axisangle class euler fromto group material mesh name pos quat rgba size type user xyaxes zaxis",
        "",
    ),
}
