"""OpenSim's inverse kinematics, on all markers of a model, each with the weight one."""

import time
from pathlib import Path

import opensim


def follow_markers(model: opensim.Model, markers: Path, out: Path, span: tuple[float, float]) -> float:
    """Write the coordinates of a model that follow a TRC between two times [s]; CPU seconds of the tool."""
    tool = opensim.InverseKinematicsTool()
    tool.setModel(model)
    for k in range(model.getMarkerSet().getSize()):
        task = opensim.IKMarkerTask()
        task.setName(model.getMarkerSet().get(k).getName())
        task.setApply(True)
        task.setWeight(1.0)
        tool.getIKTaskSet().cloneAndAppend(task)
    tool.set_marker_file(str(markers))
    tool.set_report_errors(False)
    tool.set_report_marker_locations(False)
    tool.setStartTime(span[0])
    tool.setEndTime(span[1])
    tool.setOutputMotionFileName(str(out))
    tool.setResultsDir(str(out.parent))
    start = time.process_time()
    tool.run()
    return time.process_time() - start
