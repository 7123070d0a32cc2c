"""The causes of failures, in the order in which ties are broken."""

from __future__ import annotations

from hexservo.findings.diagnosis.devices import DEVICES
from hexservo.findings.diagnosis.laws import LAWS, TASKS
from hexservo.findings.diagnosis.model import Cause
from hexservo.findings.diagnosis.tracking import TRACKING

CAUSES: tuple[Cause, ...] = (*TASKS[:1], *DEVICES, *LAWS, *TRACKING, *TASKS[1:])
