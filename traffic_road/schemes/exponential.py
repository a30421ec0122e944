"""A step of u' = L u + b N(u): the stiff linear L exactly, the remainder N, one number a system, to order 4.

Within a stage N is a polynomial in time, and the linear system under a polynomial is solved exactly, by one matrix
exponential of L augmented with the chain 1, theta, theta^2/2 (Al-Mohy and Higham, SIAM J. Sci. Comput. 33, 488, 2011):
no eigenvectors, so that an exceptional point of L does no harm. Stages and weights: Krogstad, J. Comput. Phys. 203, 72,
2005 (ETDRK4-B). Four remainders a step; exact for constant N, order 4 for smooth N, about 2 where N has kinks in time.
No stability limit from L. Of a fast decay rate, N may take back all or add two thirds: N = -theta L u is stable for
-2/3 <= theta <= 1 at any step.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm


def exact(system: np.ndarray, source: np.ndarray, step: float) -> np.ndarray:
    """The map over `step` of (u, N, step N', step^2 N'') at its start to u at its end, (size, size + 3, systems).

    `system` (systems, size, size) is L, `source` (size,) is b, the direction in which the remainder acts.
    """
    systems, size = system.shape[:2]
    augmented = np.zeros((systems, size + 3, size + 3), dtype=system.dtype)
    augmented[:, :size, :size] = step * system
    augmented[:, :size, size] = step * source
    augmented[:, size, size + 1] = augmented[:, size + 1, size + 2] = 1.0
    return np.ascontiguousarray(expm(augmented)[:, :size].transpose(1, 2, 0))


def krogstad(u: np.ndarray, remainder, half: np.ndarray, full: np.ndarray) -> np.ndarray:
    """u (size, systems) one step on; remainder(u) is (systems,), `half`, `full`: `exact` for half a step and a step."""
    size = len(u)

    def flow(propagator, *polynomial):
        return np.einsum("ijk,jk->ik", propagator[:, : size + len(polynomial)], np.concatenate((u, polynomial)))

    start = remainder(u)
    first = remainder(flow(half, start))
    second = remainder(flow(half, start, 2 * (first - start)))
    end = remainder(flow(full, start, 2 * (second - start)))
    middle = first + second
    return flow(full, start, 2 * middle - 3 * start - end, 4 * (start - middle + end))
