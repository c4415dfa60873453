"""The paper's tables and figures beside what calrig measures: `python -m tests.studies.paper`."""
