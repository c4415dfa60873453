"""Who no longer waits for long work ends it at the service too."""

from __future__ import annotations

import asyncio

import pytest
from endless_work import for_ever, working
from support import POSES, imported, wait_for

import calrig
from calrig.analysis import diagnoses
from calrig.api import heavy


@pytest.fixture
def run_id(shared_client, monkeypatch):
    """Of a run whose diagnosis does not end."""
    monkeypatch.setattr(heavy, "AT_ONCE_S", 0.0)
    monkeypatch.setattr(diagnoses, "trace", for_ever)
    return imported(shared_client, "AS-1", POSES)["id"]


def test_a_task_that_is_cancelled_cancels_the_work_that_it_waits_for(shared_client, run_id):
    async def work():
        asked = asyncio.create_task(calrig.AsyncClient(str(shared_client.base_url)).diagnose(run_id))
        await asyncio.to_thread(wait_for, working, "work")
        asked.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asked

    asyncio.run(work())
    wait_for(lambda: not working(), "end of the work")
