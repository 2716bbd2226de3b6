"""Why is the line silent? Stages in order, the first that fails named with its likely cause."""

from m100link.apps.doctor.diagnosis import diagnose
from m100link.apps.doctor.machine import Machine
from m100link.apps.doctor.port import Finding, Report, Stage, Verdict

__all__ = ["Finding", "Machine", "Report", "Stage", "Verdict", "diagnose"]
