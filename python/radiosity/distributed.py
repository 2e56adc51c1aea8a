"""Form factors that are spread over the workers of a Dask cluster: blocks of rows, each held where it was computed.

    (F x)_i = sum over j of F_ij x_j        a worker gets all of x and answers with (F x)_i for the rows i that it holds

A row by ``"monte_carlo"`` or ``"hemicube"`` depends on the scene, the seed and its number alone, so that any worker may
compute any row. Every product sums in the order of the operator of one machine: the bits are the same for any number of
workers and blocks.

A worker holds its blocks in an actor of Dask's, which answers in a few milliseconds where a task takes tens. Dask does
not compute actors anew; what a lost worker held is given to others here, and has the same bits again.
"""

from __future__ import annotations

import threading
import time
from asyncio import CancelledError
from asyncio import TimeoutError as AsyncTimeoutError
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from math import ceil
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from . import _core
from .arrays import FloatArray, aligned, read_only, row_number, seed_number, vectors, whole_number
from .form_factors import tolerance_missed
from .memory import available_bytes
from .progress import Progress, reporter
from .scene import Scene

if TYPE_CHECKING:
    import distributed

METHODS = ("monte_carlo", "hemicube")
# What asks for whole products only.
SOLVERS = ("jacobi", "gmres")

# Of a worker's memory limit: at 0.8 Dask pauses a worker, at 0.95 it ends it.
_SHARE = 0.7
# Rows that the forecast computes.
_PILOT = 8
# Of a scene with its tree, and of vectors, a patch on every worker.
_SCENE_BYTES = 600
# Blocks a worker, so that the faster may take more of them, and none waits long for the last.
_BLOCKS = 8
# Seconds: until a scheduler answers; between two looks at who is there; until lost workers have been replaced.
_CONNECT, _LOOK, _PATIENCE = 5.0, 1.0, 60.0
# Workers that may be lost over one block, and times that one may be lost.
_LOSSES = 3
_POLL = 0.01


class _Found(NamedTuple):
    """What is told of a block."""

    row_sums: FloatArray
    entries: int
    rays: int
    nbytes: int
    error_estimate: float


class _Rows(NamedTuple):
    """What determines every row of F."""

    scene: Scene
    method: str
    tolerance: float
    seed: int

    def block(
        self,
        first: int,
        last: int,
        memory: int,
        threads: int | None,
        report: Callable[[int, int], object] | None,
    ) -> _core.Block:
        """Rows ``first`` to ``last`` - 1."""
        return _core.Block.sampled(
            self.scene._core, self.method, self.tolerance, self.seed, first, last, memory, threads, report
        )

    def bytes_of_row(self) -> int:
        """The mean of a few rows spread over the scene; refuses what no worker could compute."""
        n = self.scene.n_patches
        pilot = sorted({(2 * k + 1) * n // (2 * _PILOT) for k in range(_PILOT)})
        return ceil(sum(self.block(i, i + 1, available_bytes(), None, None).nbytes for i in pilot) / len(pilot))


class _Shelf:
    """The blocks of one worker, and all that works on them there."""

    def __init__(self) -> None:
        self.blocks: dict[int, _core.Block] = {}
        self.rows: list[_Rows] = []
        self.threads = 1
        self.stopped = False

    def open(self, rows: _Rows, threads: int) -> bool:
        """What all blocks are computed from."""
        self.rows, self.threads = [rows], threads
        return True

    def assemble(self, k: int, first: int, last: int, memory: int) -> _Found:
        """Computes block k, rows ``first`` to ``last`` - 1."""
        self.stopped = False

        def watch(done: int, total: int) -> None:
            if self.stopped:
                raise RuntimeError(f"block {k} was stopped at {done} of {total} rows")

        block = self.rows[0].block(first, last, min(memory, available_bytes()), self.threads, watch)
        self.blocks[k] = block
        return _Found(block.row_sums(self.threads), block.entries, block.rays, block.nbytes, block.error_estimate)

    async def stop(self) -> None:
        """Ends what is being computed; a coroutine, as these do not wait for it."""
        self.stopped = True

    def apply(self, blocks: list[int], x: FloatArray) -> list[FloatArray]:
        values = aligned(x)
        return [self.blocks[k].apply(values, self.threads) for k in blocks]

    def standard_error(self, blocks: list[int], x: FloatArray) -> list[FloatArray]:
        values = aligned(x)
        return [self.blocks[k].standard_error(values, self.threads) for k in blocks]

    def sampling_error(self, blocks: list[int], x: FloatArray, draw: int, before: list[int]) -> list[FloatArray]:
        values = aligned(x)
        return [self.blocks[k].sampling_error(values, draw, before[k], self.threads) for k in blocks]

    def row(self, k: int, i: int) -> FloatArray:
        return self.blocks[k].row(i)


@dataclass
class _Worker:
    """One worker as the driver sees it."""

    address: str
    threads: int
    budget: int
    """Bytes that its blocks may take."""
    actor: distributed.Future
    """What keeps its shelf alive."""
    shelf: Any = None
    """Where its blocks are: an actor."""
    blocks: list[int] = field(default_factory=list)
    held: int = 0
    """Bytes of its blocks."""


class _Examined(NamedTuple):
    """What a worker tells of itself."""

    version: str
    threads: int
    limit: int
    """Memory limit that Dask watches, bytes; 0 for none."""
    used: int
    available: int


def form_factors(
    scene: Scene,
    client: distributed.Client | str,
    tolerance: float = 1e-2,
    method: str = "monte_carlo",
    seed: int = 0,
    blocks: int | None = None,
    progress: Progress = True,
) -> DistributedFormFactors:
    """The form factors of a scene, their rows spread over the workers of a Dask cluster.

    The factors are those of :func:`radiosity.form_factors` with the same method, tolerance and seed, bit for bit. A
    worker computes on as many threads as Dask gives it. Needs the extra ``distributed`` here, on the workers and where
    the scheduler runs.

    Args:
        scene: the patches.
        client: a ``distributed.Client``, or the address of a scheduler. ``Client(..., direct_to_workers=True)`` spares
            the way over the scheduler where the workers can be reached.
        tolerance: bound on the expected row error, the sum over j of E abs(dF_ij), in [1e-10, 1).
        method: ``"monte_carlo"`` or ``"hemicube"``, as in :func:`radiosity.form_factors`.
        seed: of the rays.
        blocks: how many blocks of rows; None for eight a worker, or more where memory is short.
        progress: see :mod:`radiosity.progress`; counts rows.

    Raises:
        ImportError: the extra is not installed.
        TypeError, ValueError: an unknown method, a value out of range, a scene with mirrors or glass.
        ConnectionError: the scheduler cannot be reached, or it has no workers.
        RuntimeError: a worker, by its address, or the scheduler has not this version of radiosity; or several workers
            were lost over one block.
        MemoryError: the factors would not fit into the workers. The forecast, from eight rows, is made before the scene
            is sent; rows that turn out larger are refused as they outgrow the memory.

    Warns:
        UserWarning: the tolerance was not met by as many rays as the method may cast.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a radiosity.Scene, not {type(scene).__name__}")
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}; the methods of distributed.form_factors are {METHODS}")
    number = seed_number(seed)
    if blocks is not None:
        blocks = whole_number("blocks", blocks, 1, scene.n_patches)
    with reporter(progress, "form factors") as report:
        F = DistributedFormFactors(_Rows(scene, method, float(tolerance), number), _connected(client), blocks, report)
    tolerance_missed(F.error_estimate, tolerance, method)
    return F


class DistributedFormFactors:
    """The form factors of a scene, held by the workers of a Dask cluster; made by :func:`form_factors`.

    :func:`radiosity.solve_system` takes it with ``method="jacobi"`` or ``"gmres"``. When a worker is lost, the next
    product computes its rows anew on the others, or on the one that takes its place. The workers let go of the rows
    when the object is gone.
    """

    scene: Scene
    """The scene that the factors belong to."""
    method: str
    """``"monte_carlo"`` or ``"hemicube"``."""
    tolerance: float
    """The tolerance that was asked for."""
    seed: int
    """The seed of the rays."""

    def __init__(
        self,
        rows: _Rows,
        client: distributed.Client,
        blocks: int | None,
        report: Callable[[int, int], object] | None,
    ) -> None:
        self.scene, self.method = rows.scene, rows.method
        self.tolerance, self.seed = rows.tolerance, rows.seed
        self._rows, self._client = rows, client
        self._lock = threading.Lock()
        self._workers: dict[str, _Worker] = {}
        n = rows.scene.n_patches
        alive = _alive(client)
        _examine_scheduler(client)
        fit = _examined(client, list(alive))
        if not fit:
            raise ConnectionError("the cluster has no workers; start some and call again")
        self._bytes_of_row = rows.bytes_of_row()
        budgets = [self._budget(told) for told in fit.values()]
        # No block takes more than an eighth of a worker's memory.
        most_rows = max(min(budgets) // (8 * self._bytes_of_row), 1)
        count = blocks or min(n, max(_BLOCKS * len(fit), ceil(n / most_rows)))
        self._bounds = [k * n // count for k in range(count + 1)]
        size = self._forecast(0)
        # While the last block is put together its entries are held twice.
        room = sum(max(2 * budget // size - 1, 0) for budget in budgets)
        if room < count:
            raise MemoryError(
                f"the form factors of {n} patches need about {_mib(n * self._bytes_of_row)} in {count} blocks (from "
                f"{_PILOT} rows), and {_mib(size)} to put one together, but the {len(fit)} workers can take "
                f"{', '.join(_mib(max(budget, 0)) for budget in budgets)}; use more workers or memory, more blocks, or "
                "a looser tolerance"
            )
        self._found: dict[int, _Found] = {}
        self._losses = [0] * count
        self._farewells: Counter[str] = Counter()
        self._open(fit)
        with self._lock:
            self._assemble(report)
        self._before = list(accumulate((self._found[k].entries for k in range(count - 1)), initial=0))

    def __repr__(self) -> str:
        return (
            f"DistributedFormFactors({self.shape[0]} patches, {len(self._workers)} workers, {self.nbytes} bytes, "
            f"row error about {self.error_estimate:.2g})"
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(n, n)."""
        return self.scene.n_patches, self.scene.n_patches

    @property
    def areas(self) -> FloatArray:
        """(n,) areas A, m^2."""
        return self.scene.areas

    @cached_property
    def row_sums(self) -> FloatArray:
        """(n,) sum over j of F_ij; 1 in a closed scene."""
        return read_only(np.concatenate([self._found[k].row_sums for k in range(len(self._losses))]))

    @cached_property
    def remainder(self) -> FloatArray:
        """(n,) 1 - row sum: what leaves the scene or meets backs, never clipped."""
        return read_only(1.0 - self.row_sums)

    @property
    def nbytes(self) -> int:
        """Bytes held by all workers."""
        return sum(found.nbytes for found in self._found.values())

    @property
    def error_estimate(self) -> float:
        """Estimate of max_i sum_j abs(dF_ij), as :attr:`radiosity.FormFactors.error_estimate`."""
        return max(found.error_estimate for found in self._found.values())

    @property
    def segments(self) -> int:
        """Number of rays cast."""
        return sum(found.rays for found in self._found.values())

    @property
    def held(self) -> dict[str, int]:
        """Bytes held by each worker, by its address."""
        return {worker.address: worker.held for worker in self._workers.values()}

    def __matmul__(self, x: Any) -> FloatArray:
        """F @ x for x of shape (n,) or (n, k): the irradiance that the radiosities x cause.

        Raises:
            ConnectionError: no worker is left, or the scheduler is gone.
            MemoryError: the rows of a lost worker fit nowhere else.
        """
        columns, shape = vectors("x", x, self.shape[0])
        return self.apply(columns).reshape(shape)

    def apply(self, x: FloatArray) -> FloatArray:
        """F @ x for a contiguous x of shape (n, k)."""
        return self._ask("apply", x)

    def row(self, i: int) -> FloatArray:
        """(n,) row i: where the light of patch i goes. Raises ``IndexError`` when there is no such patch."""
        number = row_number(i, self.shape[0])
        k = int(np.searchsorted(self._bounds, number, side="right")) - 1
        with self._lock:
            answer: FloatArray | None = None
            while answer is None:
                self._assemble(None)
                worker = next(worker for worker in self._workers.values() if k in worker.blocks)
                answer = self._answer(worker, self._call(worker, "row", k, number - self._bounds[k]))
        return aligned(answer)

    def standard_error(self, x: FloatArray) -> FloatArray:
        """(n, k) standard error of F @ x that the sampling of F leaves; x of shape (n, k)."""
        return self._ask("standard_error", x)

    def sampling_error(self, x: FloatArray, draw: int) -> FloatArray:
        """(n, k) one realisation, number ``draw``, of the error of F @ x; x of shape (n, k)."""
        return self._ask("sampling_error", x, draw, self._before)

    def _operator(self) -> _core.FormFactors:
        """What the solvers of the core see; one solve each, as an exception in a product ends it."""
        return _core.FormFactors.remote(
            self.areas, self.row_sums, self.nbytes, self.error_estimate, self.segments, self
        )

    def _ask(self, what: str, x: FloatArray, *more: Any) -> FloatArray:
        """Every row's answer."""
        out = np.empty_like(x)
        with self._lock:
            missing = set(range(len(self._losses))) if x.size else set()
            while missing:
                self._assemble(None)
                calls = [
                    (worker, blocks, self._call(worker, what, blocks, x, *more))
                    for worker in self._workers.values()
                    if (blocks := [k for k in worker.blocks if k in missing])
                ]
                for worker, blocks, call in calls:
                    answers = self._answer(worker, call)
                    if answers is None:
                        continue
                    for k, answer in zip(blocks, answers, strict=True):
                        out[self._bounds[k] : self._bounds[k + 1]] = answer
                    missing.difference_update(blocks)
        return out

    def _assemble(self, report: Callable[[int, int], object] | None) -> None:
        """Has every block computed that nobody holds, by workers that have room for it."""
        held = {k for worker in self._workers.values() for k in worker.blocks}
        if len(held) == len(self._losses):
            return
        running: dict[str, tuple[_Worker, int, Any]] = {}
        looked = worked = time.monotonic()
        try:
            while len(held) < len(self._losses):
                now = time.monotonic()
                if now - looked > _LOOK:
                    self._look(running)
                    looked = now
                busy = {k for _, k, _ in running.values()}
                held = {k for worker in self._workers.values() for k in worker.blocks}
                waiting = [k for k in range(len(self._losses)) if k not in held and k not in busy]
                self._start(waiting, running)
                if running:
                    worked = now
                elif waiting and now - worked > _PATIENCE:
                    raise self._nobody(waiting[0])
                for worker, k, call in list(running.values()):
                    if call is None or call.done():
                        del running[worker.address]
                        self._finish(worker, k, call)
                        if report is not None:
                            told = sum(len(self._found[k].row_sums) for k in self._found)
                            report(told, self._bounds[-1])
                held = {k for worker in self._workers.values() for k in worker.blocks}
                time.sleep(_POLL)
        finally:
            for worker, _, _ in running.values():
                # Nobody waits for the answer.
                self._call(worker, "stop")

    def _start(self, waiting: list[int], running: dict[str, tuple[_Worker, int, Any]]) -> None:
        """Gives blocks to workers that are free and have room."""
        for worker in list(self._workers.values()):
            room = worker.budget - worker.held
            if not waiting or worker.address in running or self._forecast(waiting[0]) > room:
                continue
            k = waiting.pop(0)
            call = self._call(worker, "assemble", k, self._bounds[k], self._bounds[k + 1], room)
            running[worker.address] = worker, k, call

    def _finish(self, worker: _Worker, k: int, call: Any) -> None:
        """Takes note of a block that a worker has computed."""
        try:
            found = self._answer(worker, call)
        except MemoryError as error:
            raise MemoryError(f"worker {worker.address}: {error}") from error
        if found is None:
            self._count_loss(k)
        else:
            worker.blocks.append(k)
            worker.held += found.nbytes
            # What is computed again is the same.
            self._found.setdefault(k, found)

    def _look(self, running: dict[str, tuple[_Worker, int, Any]]) -> None:
        """Says farewell to workers that are gone and welcomes new ones."""
        alive = _alive(self._client)
        for worker in [worker for worker in self._workers.values() if worker.address not in alive]:
            self._lose(worker)
            if worker.address in running:
                self._count_loss(running.pop(worker.address)[1])
        new = [address for address in alive if address not in self._workers]
        if new:
            self._open(_examined(self._client, new))

    def _open(self, examined: dict[str, _Examined]) -> None:
        """Sends the scene to workers."""
        import distributed

        workers = []
        for address, told in examined.items():
            actor = self._client.submit(_Shelf, actor=True, pure=False, workers=[address])
            workers.append(_Worker(address, told.threads, self._budget(told), actor))
        for worker in workers:
            if self._answer(worker, worker.actor) is not None:
                # Which client it speaks through is told here: there may be several, or none by default.
                with self._client.as_current():
                    worker.shelf = distributed.Actor(_Shelf, worker.address, worker.actor.key)
        calls = [(worker, self._call(worker, "open", self._rows, worker.threads)) for worker in workers]
        self._workers.update({worker.address: worker for worker, call in calls if self._answer(worker, call)})

    def _call(self, worker: _Worker, what: str, *arguments: Any) -> Any:
        """A future of what the worker's shelf answers; None where the worker is known to be lost."""
        if worker.shelf is None:
            return None
        try:
            method = getattr(worker.shelf, what)
        except (RuntimeError, ValueError):
            # The actor has been told; Dask says it by the one or the other, by its version.
            return None
        return method(*arguments)

    def _answer(self, worker: _Worker, call: Any) -> Any:
        """What a future holds in the end; None, and the worker is forgotten, when it is lost."""
        while call is not None and not _settled(call):
            # Dask waits for ever for a worker that does not come back.
            if worker.address not in _alive(self._client):
                call = None
        # A shelf that Dask has set up anew is empty: LookupError.
        with suppress(OSError, CancelledError, LookupError):
            if call is not None:
                return call.result()
        self._lose(worker)
        return None

    def _lose(self, worker: _Worker) -> None:
        self._workers.pop(worker.address, None)
        self._farewells[worker.address] += 1
        if self._farewells[worker.address] >= _LOSSES:
            raise ConnectionError(f"worker {worker.address} came back and was lost again, {_LOSSES} times")
        if self._client.status == "running":
            # Else Dask keeps waiting for the worker.
            self._client.cancel([worker.actor])

    def _count_loss(self, k: int) -> None:
        self._losses[k] += 1
        if self._losses[k] >= _LOSSES:
            raise RuntimeError(
                f"rows {self._bounds[k]} to {self._bounds[k + 1] - 1}: {_LOSSES} workers were lost while they computed "
                "them, probably as their memory ran out; use more blocks or workers with more memory"
            )

    def _nobody(self, k: int) -> Exception:
        """Why a block finds no worker."""
        if not self._workers:
            return ConnectionError(f"the cluster has had no workers for {_PATIENCE:g} s")
        return MemoryError(
            f"rows {self._bounds[k]} to {self._bounds[k + 1] - 1} need about {_mib(self._forecast(k))}, which none of "
            f"the {len(self._workers)} workers has left; use more workers, more memory or a looser tolerance"
        )

    def _forecast(self, k: int) -> int:
        """Bytes that it takes to put block k together: its entries are held twice meanwhile."""
        return 2 * (self._bounds[k + 1] - self._bounds[k]) * self._bytes_of_row

    def _budget(self, told: _Examined) -> int:
        """Bytes of blocks that a worker may hold."""
        limit = int(_SHARE * told.limit) - told.used if told.limit else told.available
        return min(limit, told.available) - _SCENE_BYTES * self.scene.n_patches


def _connected(client: Any) -> distributed.Client:
    """The client itself, or a new one for an address."""
    try:
        import distributed
    except ImportError as error:
        raise ImportError(
            "radiosity.distributed needs Dask's distributed, here and on the workers: "
            "pip install 'radiosity[distributed]'"
        ) from error
    if isinstance(client, str):
        try:
            client = distributed.Client(client, timeout=_CONNECT, set_as_default=False)
        except OSError as error:
            raise ConnectionError(f"no scheduler answers at {client!r} within {_CONNECT:g} s: {error}") from error
    if not isinstance(client, distributed.Client) or client.asynchronous:
        raise TypeError(
            f"client must be a synchronous distributed.Client or an address, not {type(client).__name__}"
            f"{' that is asynchronous' if isinstance(client, distributed.Client) else ''}"
        )
    return client


def _alive(client: distributed.Client) -> dict[str, int]:
    """The workers that the scheduler knows, by address."""
    if client.status != "running":
        raise ConnectionError(f"the cluster is gone: its client is {client.status}")
    try:
        return dict(client.nthreads())
    except OSError as error:
        raise ConnectionError(f"the cluster is gone: {error}") from error


def _examine_scheduler(client: distributed.Client) -> None:
    """Looks whether the scheduler understands what passes through it."""
    from . import __version__

    def version() -> str:
        import radiosity.distributed

        return radiosity.__version__

    try:
        told = client.run_on_scheduler(version)
    except ImportError as error:
        raise RuntimeError(f"the scheduler cannot import radiosity.distributed: {error}") from error
    if told != __version__:
        raise RuntimeError(f"the scheduler has radiosity {told}, but {__version__} is needed, as here")


def _settled(call: Any) -> bool:
    """Whether a future has an outcome, within a second."""
    try:
        call.result(timeout=_LOOK)
    except (TimeoutError, AsyncTimeoutError):
        # The outcome may be an error of this kind.
        return bool(call.done())
    except Exception:
        return True
    return True


def _examined(client: distributed.Client, addresses: list[str]) -> dict[str, _Examined]:
    """Looks at workers before they are asked for anything."""
    from . import __version__

    def examine(dask_worker: Any) -> tuple[str, int, int, int, int]:
        # Dask carries a function within a function as code: this one runs where there is no radiosity.
        import radiosity.distributed
        from radiosity.memory import available_bytes

        limit = dask_worker.memory_manager.memory_limit
        used = dask_worker.monitor.get_process_memory()
        return radiosity.__version__, dask_worker.state.nthreads, limit or 0, used, available_bytes()

    fit = {}
    for address, told in client.run(examine, workers=addresses, on_error="return").items():
        if isinstance(told, OSError):
            # It is gone, or not there yet.
            continue
        if isinstance(told, Exception):
            raise RuntimeError(f"worker {address} cannot import radiosity: {type(told).__name__}: {told}")
        if told[0] != __version__:
            raise RuntimeError(f"worker {address} has radiosity {told[0]}, but {__version__} is needed, as here")
        fit[address] = _Examined(*told)
    return fit


def _mib(nbytes: int) -> str:
    return f"{nbytes / 2**20:.3g} MiB"
