"""What a marker's label says by itself: a side, and a landmark or a segment, in the abbreviations of several schools.

The words follow Plug-in Gait and the Conventional Gait Model (Vicon), the anatomical abbreviations of van Sint Jan
(Color Atlas of Skeletal Landmark Definitions, 2007), the Calibrated Anatomical System Technique (Cappozzo et al.,
Clin Biomech 10:171 (1995)), the Human Body Model, Cleveland Clinic and Helen Hayes sets, the animation set of Qualisys,
and sides in English, German, French, Italian and Spanish.
"""

import re
from functools import cache

from torchid.model.marker_set import MarkerSpec

SIDES = {
    "l": ("l", "left", "lt", "li", "links", "gauche", "g", "izq", "izquierda", "sx", "sin", "sinistra"),
    "r": ("r", "right", "rt", "re", "rechts", "droite", "d", "der", "derecha", "dx", "dex", "destra"),
}
"""Words for sides, where they stand apart."""
_M, _L = "(?:medial|med|mid|int|inner|in|m)", "(?:lateral|lat|ext|outer|out|l)"
_N = "[0-9]*"
_AT = (
    "(?:upper|up|lower|low|front|frt|rear|back|lateral|lat|medial|med|ant|post|sup|inf|prox|dist|high|mid|"
    "side|clust[a-z]*|"
    "super|frontal|[apdl]{1,2})*[0-9]*[a-d]?"
)
"""Where on a segment, and which of several."""
_KNEE, _ANKLE = "(?:knee|kne|kn)", "(?:ankle|ankl|ank|an|malleolus|mall|mal)"
_ELBOW, _WRIST = "(?:elbow|elb|el)", "(?:wrist|wri|wr)"
CENTRAL = {
    "c7": "c0?7|cv7|cer7|vertebraprominens",
    "t10": "t10|tv10|th10",
    "jugular_notch": "clav|clavicle|clavicula|cla|ij|sjn|jn|(?:suprasternal|sternal|jugular)notch|manubrium|manu",
    "xiphoid": "strn|stern|ster|xip|xiph|xyph|xpho|xiphoid(?:process)?|px|sxs",
}
"""Landmarks in the middle of the thorax."""
MIDDLE = {
    "thorax": f"sternum{_N}|chest{_N}|t(?:h|v|v0|0)?(?:[1-9]|1[12])|bak|back|bbac|upback|mai|spine(?:top|"
    f"upper|thoracic){_N}",
    "pelvis": f"(?:v?sac|v?sacr|v?sacrum|v?sacral){_N}|v?s[12]|(?:pelvis|pelv|pel|pv){_N}|waist[a-z]*",
    "head": f"(?:head|hed|hd){_N}|topofhead|tophead|headtop|thead|vertex|vtx|forehead|glabella|nose|htop|"
    "[fb]head|head[fb]|"
    "headfront|headback|fronthead|backhead",
}  # fmt: skip
"""Segments in the middle, where no side is told."""
SIDED = {
    ("pelvis", "asis"): "asis|asi|sias|eias|ias|spinailiacaant",
    ("pelvis", "psis"): "psis|psi|sips|eips|ips|spinailiacapost",
    ("pelvis", None): "ic|icr|iliac|iliaccrest|icrest|ilcrest|ilc|ict|crest|pelvis|pelv",
    ("thigh", "trochanter"): "ftc|gtr|gt|gtro|g?troch?|(?:greater)?troch(?:anter)?|trc",
    ("thigh", "knee_lateral"): f"{_KNEE}|{_L}{_KNEE}|{_KNEE}{_L}|fle|lfe|lfc|le|lek|lep|lepi|"
    f"{_L}fem[a-z]*cond[a-z]*",
    ("thigh", "knee_medial"): f"{_M}{_KNEE}|{_KNEE}{_M}|fme|mfe|mfc|me|mek|mep|mepi|{_M}fem[a-z]*cond[a-z]*",
    ("thigh", None): f"(?:thigh|thi|thg|tgh|thl|th|tig|femur|fem|quad){_AT}",
    ("shank", "ankle_lateral"): f"{_ANKLE}|{_L}{_ANKLE}|{_ANKLE}{_L}|lm|fal|lma",
    ("shank", "ankle_medial"): f"{_M}{_ANKLE}|{_ANKLE}{_M}|mm|tam|mma|sph|sphyrion",
    ("shank", None): f"(?:shank|shnk|shk|shan|shn|sha|shin|sk|sh|tibia|tib|tia|tb|ati|calf|lowerleg){_AT}|ttc|"
    "tt|t?tub|"
    "tib(?:ial?)?tub[a-z]*|tuber[a-z]*|hf|hfb|fh|fax|fib|fibula|fib(?:ula[r]?)?head",
    ("foot", "heel"): f"(?:hee|heel|hel|hl|calc|cal|ca|calcaneus|calcn){_N}|fcc|pca|heelback",
    ("foot", "toe"): f"toe{_N}|sm|[fdp]m2|[fdp]?2mt?|mt2|met2|mth2|mh2|2meta?|2ndmet[a-z]*|toetip|tiptoe|forefoot2",
    ("foot", "mt1"): "fm|[fdp]m1|[fdp]?1mt?|mt1|met1|mth1|mh1|mtp1|1meta?|1stmet[a-z]*|vm1|toemed|"
    "forefoot(?:in|1)|p1mt",
    ("foot", "mt5"): "vm|[fdp]m5|[fdp]?5mt?|dmt5|mt5|met5|mth5|mh5|mtp5|5meta?|5thmet[a-z]*|vm5|toelat|vmh|"
    "forefoot(?:out|5)",
    ("foot", None): f"(?:foot|midfoot|medfoot|forefoot){_AT}|(?:midfoot|forefoot)[a-z]*|hallux|hlx|hlux|hal|"
    "nav|navicular|stl|"
    "cpg|[lm]ca|bigtoe|littletoe|instep|tarsal[a-z]*|cuboid|[fdp]?m[34]|mt[34]|shoe[a-z]*|fmt",
    ("thorax", "acromion"): "(?:shoulder|shoul|shld|shlr|sho)(?:top)?|acr|acro|acrom|acromion|acromium|sae|sa",
    ("thorax", None): f"clav|clavicle|cla|collar|(?:scap|scapula)[a-z]*{_N}|sia|srs|saa|ia|ts|bak|back|"
    f"sternum{_N}|rib{_N}|"
    "chest|offset|[ap]sh|ac|aa|shoulderback",
    ("upper_arm", "elbow_lateral"): f"{_ELBOW}|{_L}{_ELBOW}|{_ELBOW}{_L}|hle|lel|lee|epilat",
    ("upper_arm", "elbow_medial"): f"{_M}{_ELBOW}|{_ELBOW}{_M}|hme|mel|mee|epimed",
    ("upper_arm", None): f"(?:upa|uparm|upperarm|uarm|ua|humerus|hum|biceps?|triceps?|arm|delt|deltoid){_AT}",
    ("forearm", "wrist_radial"): f"wra|rsp|rst|wrr|{_WRIST}(?:rad|radial|radius|thumb|{_M}|a)|rad|radius|"
    "radialstyloid|mw",
    ("forearm", "wrist_ulnar"): f"wrb|usp|ust|uhe|wru|{_WRIST}(?:uln|ulna|ulnar|pinky|{_L}|b)|uln|ulna|"
    "ulnarstyloid|lw",
    ("forearm", None): f"(?:fra|frm|farm|forearm|fa|frarm|lowerarm)(?:{_AT}|superior|inferior|radi[a-z]*|"
    f"ulnar?)|{_WRIST}{_N}|"
    "uoa|olecranon",
    ("hand", None): f"(?:fin|finger|hand|han|hnd|hn|ha){_N}|(?:mc|hm|mcp)[1-5]|mcp|knuckle|hand(?:out|in|mid)|thumb",
    ("head", "head_front"): "fhd|fhead|headfront|fronthead|hdf|frontofhead",
    ("head", "head_back"): "bhd|bhead|headback|backhead|hdb|backofhead",
    ("head", None): f"(?:head|hed|hd){_N}|temple|temp|ear|tragus|eye|headside|sidehead",
}  # fmt: skip
"""What stands beside a side: segment without it, landmark without it, pattern. A word with two meanings has none."""
TRUNK = ("pelvis", "thorax", "head")
"""Segments that both sides share."""


def told_by_words(label: str) -> MarkerSpec | None:
    """Return where a marker is by its label alone, None where that says nothing, or several things.

    Args:
        label: as in the file, with or without a prefix.
    """
    words = _words(label.rsplit(":", 1)[-1])
    plain = "".join(words)
    middle = _middle(plain)
    if middle is not None:
        return middle
    found = {spec for side, rest in _sided(words, plain) for spec in _beside(side, rest)}
    return found.pop() if len(found) == 1 else None


def _words(label: str) -> list[str]:
    """Return the words of a label in small letters; a capital after a small letter begins one."""
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", label)
    return [word.lower() for word in re.split(r"[^A-Za-z0-9]+", apart) if word]


def _middle(plain: str) -> MarkerSpec | None:
    for landmark, pattern in CENTRAL.items():
        if _matches(pattern, plain):
            return MarkerSpec("thorax", landmark)
    return next((MarkerSpec(segment) for segment, p in MIDDLE.items() if _matches(p, plain)), None)


def _sided(words: list[str], plain: str) -> list[tuple[str, str]]:
    """Return the sides that a label may tell, each with the rest: words of their own, else its first or last letter."""
    apart = [(side, k) for side, known in SIDES.items() for k, word in enumerate(words) if word in known]
    if apart and len(words) > 1:
        return [(side, "".join(words[:k] + words[k + 1 :])) for side, k in apart]
    first = [(plain[0], plain[1:])] if plain[:1] in ("l", "r") else []
    return first or ([(plain[-1], plain[:-1])] if plain[-1:] in ("l", "r") else [])


def _beside(side: str, rest: str) -> list[MarkerSpec]:
    """Return what a word beside a side may mean; a landmark goes before its segment alone."""
    found = [place for place, pattern in SIDED.items() if _matches(pattern, rest)]
    exact = [place for place in found if place[1] is not None] or found
    return [
        MarkerSpec(
            segment if segment in TRUNK else f"{segment}_{side}", None if landmark is None else f"{landmark}_{side}"
        )
        for segment, landmark in exact
    ]


@cache
def _compiled(pattern: str) -> re.Pattern[str]:
    return re.compile(pattern)


def _matches(pattern: str, text: str) -> bool:
    return _compiled(pattern).fullmatch(text) is not None
