"""A running service from Python: `Client("http://lab-pc:8000").calibrate("AS-0042").result.bias_deg`.

It needs httpx and pydantic, nothing of the service itself.
"""

from calrig.client.asynchronous import AsyncClient, AsyncRun
from calrig.client.client import Client
from calrig.client.documents import PlanDesign, RunEvent, RunRecord
from calrig.client.errors import Invalid, Refused, RunFailed, ServiceError, Unreachable
from calrig.client.run import Run
from calrig.model.calibration import Revision
from calrig.model.comparison import Comparison
from calrig.model.diagnosis import Diagnosis
from calrig.model.plan_design import Estimate
from calrig.model.result import Result
from calrig.model.service import RigState
from calrig.model.solution import Solution

__all__ = [
    "AsyncClient",
    "AsyncRun",
    "Client",
    "Comparison",
    "Diagnosis",
    "Estimate",
    "Invalid",
    "PlanDesign",
    "Refused",
    "Result",
    "Revision",
    "RigState",
    "Run",
    "RunEvent",
    "RunFailed",
    "RunRecord",
    "ServiceError",
    "Solution",
    "Unreachable",
]
