"""Where jobs are done: processes of this machine, or the workers of a Dask cluster.

Both go on when a worker dies: finished jobs are kept, and the job it worked on is tried again.
"""

import multiprocessing
import signal
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING, Protocol

from ovmot.batch.jobs import Job
from ovmot.batch.work import Outcome
from ovmot.errors import InputError
from ovmot.runtime import n_processors

if TYPE_CHECKING:
    from distributed import Client

Work = Callable[[Job], Outcome]
Say = Callable[[str], None]
"""Is given a line about a worker that died."""


class Executor(Protocol):
    """Does jobs somewhere; gives each one's outcome as it ends."""

    def __call__(self, work: Work, jobs: Sequence[Job]) -> Iterator[Outcome]: ...


class LocalProcesses:
    """Each job in a process of this machine, `workers` of them at a time.

    A pool whose worker dies is lost whole, and does not say which job it was; so the jobs that
    were under way are tried again one at a time, each in a pool of its own.
    """

    def __init__(
        self, workers: int | None = None, retries: int = 2, on_death: Say = lambda line: None
    ) -> None:
        self._workers = workers or n_processors()
        self._retries = retries
        self._on_death = on_death

    def __call__(self, work: Work, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Outcomes in the order in which they come."""
        waiting = list(jobs)
        while waiting:
            suspects: list[Job] = []
            yield from self._pool(work, waiting, suspects)
            if suspects:
                names = ", ".join(job.name for job in suspects)
                self._on_death(f"a worker died; tried again one at a time: {names}")
            for job in suspects:
                yield self._alone(work, job)

    def _pool(self, work: Work, waiting: list[Job], suspects: list[Job]) -> Iterator[Outcome]:
        """Work through `waiting`; when the pool breaks, the jobs under way become suspects."""
        with self._new_pool(self._workers) as pool:
            under_way: dict[Future[Outcome], Job] = {}
            try:
                while waiting or under_way:
                    while waiting and len(under_way) < self._workers:
                        under_way[pool.submit(work, waiting[0])] = waiting[0]
                        del waiting[0]
                    for done in wait(under_way, return_when=FIRST_COMPLETED).done:
                        try:
                            outcome = done.result()
                        except BrokenProcessPool:
                            suspects.extend(under_way.values())
                            return
                        except Exception as error:
                            outcome = unexpected(under_way[done], error)
                        del under_way[done]
                        yield outcome
            except BrokenProcessPool:  # between two jobs: nothing was lost but those under way
                suspects.extend(under_way.values())
            except (KeyboardInterrupt, GeneratorExit):  # what is under way would hold us up
                for process in multiprocessing.active_children():
                    process.terminate()
                raise
            finally:
                pool.shutdown(cancel_futures=True)

    def _alone(self, work: Work, job: Job) -> Outcome:
        for attempt in range(1, self._retries + 1):
            with self._new_pool(1) as pool:
                try:
                    return pool.submit(work, job).result()
                except BrokenProcessPool:
                    self._on_death(f"{job.name}: its worker died, try {attempt} of {self._retries}")
                except Exception as error:
                    return unexpected(job, error)
        return Outcome(job.name, f"its process died {self._retries + 1} times")

    def _new_pool(self, workers: int) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(workers, context, initializer=_end_without_words)


class DaskCluster:
    """Each job on some worker of a Dask cluster, which must see the same files.

    Dask itself moves the jobs of a dead worker to another one, some times; `retries` come on top.
    """

    def __init__(
        self,
        address: str,
        retries: int = 2,
        timeout_s: float = 10.0,
        on_death: Say = lambda line: None,
    ) -> None:
        self._on_death = on_death
        self._address = address
        self._retries = retries
        self._timeout_s = timeout_s

    def __call__(self, work: Work, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Outcomes in the order in which they come; raises `InputError` without a cluster."""
        client = self._client()
        from distributed import KilledWorker, as_completed

        with client:
            job_of = {client.submit(work, job, pure=False): job for job in jobs}
            tries: Counter[str] = Counter()
            queue = as_completed(job_of, loop=client.loop)
            for done in queue:
                job = job_of.pop(done)
                error = done.exception()
                if error is None:
                    yield done.result()
                elif isinstance(error, KilledWorker) and tries[job.name] < self._retries:
                    tries[job.name] += 1
                    self._on_death(f"{job.name}: its worker died, try {tries[job.name]}")
                    again = client.submit(work, job, pure=False)
                    job_of[again] = job
                    queue.add(again)
                else:
                    yield unexpected(job, error)

    def _client(self) -> "Client":
        try:
            from distributed import Client
        except ImportError:
            problem = "a Dask cluster needs the package distributed"
            raise InputError(f"--cluster: {problem}; pip install 'ovmot[cluster]'") from None
        try:
            return Client(self._address, timeout=self._timeout_s, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"--cluster {self._address}: no scheduler answers there; start one with"
                f" 'dask scheduler' ({type(error).__name__})"
            ) from None


def _end_without_words() -> None:
    """Ctrl-C reaches every process of a terminal; only the first one is to speak."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def unexpected(job: Job, error: BaseException) -> Outcome:
    """The outcome of a job that ended by an unexpected error, with the error's own words."""
    return Outcome(job.name, f"{type(error).__name__}: {' '.join(str(error).split())}")
