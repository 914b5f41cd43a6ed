"""One self-contained page about a run."""

from torchid.report.page import write_report as write_report
