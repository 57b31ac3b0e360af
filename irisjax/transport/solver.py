"""What instruments and the inversion ask of a solver."""

import abc
from collections.abc import Callable

import equinox as eqx

from irisjax.tissue.layers import Layers
from irisjax.transport.process import Process
from irisjax.transport.solution import Solution


class AbstractSolver(eqx.Module):
    """A solver is an immutable value: a method and its settings.

    A new one is a subclass with these two methods; no instrument needs to know of it.
    """

    @abc.abstractmethod
    def prepare(self, layers: Callable[[], Layers], process: Process) -> "AbstractSolver":
        """The solver with all fixed that must be known before tracing.

        `layers` gives the layers (concrete ones, if the caller has them) when called. **Raises:**
        `ValueError` for a process that the solver does not treat.
        """

    @abc.abstractmethod
    def solve(
        self,
        layers: Layers,
        process: Process,
        cos_incidence,
        *,
        cos_exit=None,
        azimuth=None,
        key=None,
        rays=None,
    ) -> Solution:
        """Transport of light from direction `cos_incidence` in the aqueous humour, or `DIFFUSE`.

        **Arguments:** `cos_exit`, `azimuth`: exit directions, shape (exits,), for the BRDF, or
        `None`; `key`: for solvers that sample; `rays`: relative number of rays a wavelength for
        those.
        """
