"""nimblephysics on one trial, in its own environment: prints CPU seconds per frame."""

import sys
import time
from pathlib import Path

import nimblephysics
import numpy as np

folder, frames = Path(sys.argv[1]), int(sys.argv[2])
trial = np.load(folder / "trial.npz")
parsed = nimblephysics.biomechanics.OpenSimParser.parseOsim(str(folder / "nimble.osim"))
skeleton = parsed.skeleton
markers = [parsed.markersMap[label] for label in trial["labels"].tolist()]
rows = {skeleton.getDofByIndex(i).getName(): i for i in range(skeleton.getNumDofs())}
x = np.zeros(skeleton.getNumDofs())
for name, value in zip(trial["names"].tolist(), trial["start"].tolist(), strict=True):
    x[rows[name]] = value
skeleton.setPositions(x)
start = time.process_time()
for t in range(frames):
    skeleton.fitMarkersToWorldPositions(
        markers, trial["p"][t].ravel(), np.ones(len(markers)), False, 1e-7, 100, 1, 1e-4, True, False
    )
sys.stdout.write(f"{(time.process_time() - start) / frames}\n")
