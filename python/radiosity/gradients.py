"""Radiosity as one step of a computation in PyTorch or JAX: what paints and lamps give a wanted light?

Both solve the system forwards and its adjoint backwards (:meth:`radiosity.Solution.vjp`), on the processor and in
double precision, whatever the rest of the computation does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .arrays import FloatArray
from .relight import importance
from .system import operator_of, solved

Solver = Callable[[Any, Any], Any]


class _Steps:
    """Forwards and backwards on numpy arrays."""

    def __init__(self, F: Any, tolerance: float, threads: int | None) -> None:
        self.operator = operator_of(F)
        if not self.operator.is_at_hand:
            raise ValueError("form factors of a cluster are for one solve at a time; gradients need more")
        self.tolerance = tolerance
        self.threads = threads

    def forwards(self, emission: Any, reflectance: Any) -> tuple[FloatArray, FloatArray]:
        """B and H."""
        e, rho = (np.ascontiguousarray(x, np.float64) for x in (emission, reflectance))
        n = self.operator.core.n
        if e.ndim != 2 or e.shape[0] != n or rho.shape != e.shape:
            raise ValueError(f"emission and reflectance must both have shape ({n}, b), not {e.shape} and {rho.shape}")
        solution = solved(self.operator, e, rho, "gmres", self.tolerance, threads=self.threads, progress=False)
        return solution.radiosity, solution.irradiance

    def backwards(self, cotangent: Any, reflectance: Any, irradiance: Any) -> tuple[FloatArray, FloatArray]:
        """dl/dE and dl/drho."""
        g, rho, h = (np.ascontiguousarray(x, np.float64) for x in (cotangent, reflectance, irradiance))
        adjoint = g + importance(self.operator.core, rho, rho * g, self.tolerance, self.threads, False)
        return adjoint, adjoint * h


def torch_solver(F: Any, tolerance: float = 1e-10, threads: int | None = None) -> Solver:
    """A function ``radiosity(emission, reflectance)`` of (n, b) tensors that PyTorch differentiates.

    Args:
        F: as :func:`radiosity.solve_system` takes it.
        tolerance: relative residual of the solves forwards and backwards.
        threads: None for all cores.

    Raises:
        ImportError: PyTorch is not installed.
    """
    import torch

    steps = _Steps(F, tolerance, threads)

    def forward(context: Any, emission: Any, reflectance: Any) -> Any:
        b, h = steps.forwards(emission.detach().cpu().numpy(), reflectance.detach().cpu().numpy())
        context.save_for_backward(reflectance, emission.new_tensor(h))
        return emission.new_tensor(b)

    def backward(context: Any, cotangent: Any) -> Any:
        reflectance, h = context.saved_tensors
        found = steps.backwards(*(x.detach().cpu().numpy() for x in (cotangent, reflectance, h)))
        return tuple(reflectance.new_tensor(x) for x in found)

    # Not twice: the derivative of the derivative would come out as 0.
    once = torch.autograd.function.once_differentiable(backward)
    parts = {"forward": staticmethod(forward), "backward": staticmethod(once)}
    step: Any = type("Radiosity", (torch.autograd.Function,), parts)
    solver: Solver = step.apply
    return solver


def jax_solver(F: Any, tolerance: float = 1e-10, threads: int | None = None) -> Solver:
    """A function ``radiosity(emission, reflectance)`` of (n, b) arrays that JAX differentiates and compiles.

    JAX computes in 32 bits unless ``jax_enable_x64`` is set.

    Args:
        F: as :func:`radiosity.solve_system` takes it.
        tolerance: relative residual of the solves forwards and backwards.
        threads: None for all cores.

    Raises:
        ImportError: JAX is not installed.
    """
    import jax

    steps = _Steps(F, tolerance, threads)

    def called(step: Callable[..., tuple[FloatArray, FloatArray]], *arrays: Any) -> Any:
        like = jax.ShapeDtypeStruct(arrays[0].shape, arrays[0].dtype)

        def host(*given: Any) -> tuple[Any, ...]:
            return tuple(np.asarray(x, like.dtype) for x in step(*given))

        return jax.pure_callback(host, (like, like), *arrays, vmap_method="sequential")

    def forward(emission: Any, reflectance: Any) -> Any:
        b, h = called(steps.forwards, emission, reflectance)
        return b, (reflectance, h)

    def backward(kept: Any, cotangent: Any) -> Any:
        return called(steps.backwards, cotangent, *kept)

    radiosity = jax.custom_vjp(lambda emission, reflectance: forward(emission, reflectance)[0])
    radiosity.defvjp(forward, backward)
    solver: Solver = radiosity
    return solver
