"""How many threads linear algebra takes: one, since it works on matrices of a few hundred rows.

A second thread would spend its time in waiting for the first: on a busy machine a diagnosis then takes
several times the processor time.
"""

import os

ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def have_one_thread() -> None:
    """Have linear algebra take one thread, unless the environment says otherwise.

    It is too late once numpy has been imported.
    """
    for name in ONE_THREAD:
        os.environ.setdefault(name, "1")
