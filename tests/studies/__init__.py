"""Studies: tables and trials, each with a command of its own, `python -m tests.studies.NAME`.

accepting  effects accepted from two runs, and what they predict of a third
blind      one effect a run, named or not: the diagnosis against causes that it does not share
charts     false alarms and delays of the control charts
correlated_poses  what standard errors cover if dwells share noise
demo       the demo rig, diagnosed
fleet      what a screen of many runs takes, and what it shows
joint      the solution of stage and units together against its bound
kernels    the calibration's tests under every kernel of the processor
measured   measured logs, diagnosed
million    a centre with a million runs
paper      the paper's tables and figures beside calrig's
plans      designed plans against the fixed one
structure  how large and how deep the house is
sweeps     continuous sweeps, run after run over simulated ports
tables     how diagnoses of generated tables end
trials     what calrig must withstand, counted
verifications  false alarms of verifications, and faults found

The tests among them are collected with all others.
"""

import sys
from pathlib import Path

from calrig.processes.threads import have_one_thread

have_one_thread()
sys.path.insert(0, str(Path(__file__).parents[1]))  # as pytest does for what tests share
