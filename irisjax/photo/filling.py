"""What a photograph hides of an iris, filled by texture of the same radius elsewhere."""

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage
from skimage import measure, morphology

from irisjax.photo.texture import fill_holes

_TURNS = 48  # places round the iris from which a hidden region may be filled
_BORDER = 6  # cells about a region in which the places are compared
_MOST_OFF = 2.0  # standard deviations beyond which a difference at a border counts no more
_CONTINUED = 4  # cells next to an edge, whose mean continues it
_FADES = 0.08  # depth under a lid at which differences are a third, of the iris's width


def fill_by_texture(
    layers: Float[np.ndarray, "layers angles radii"], hidden: Bool[np.ndarray, "angles radii"]
) -> Float[np.ndarray, "layers angles radii"]:
    """Fill hidden cells of polar maps; the others stay exact.

    The edges, where pupil or white show through all round, continue the cells next to them. Each
    other region is filled from another place: the iris is turned by the angle at which it is seen,
    differs least along the region's border, and is nearest to the median at each radius, so that a
    mirror image which was taken for iris is not repeated. What still differs at the border is
    spread smoothly over a region with a border all round. Under a lid, whose shade alone may be the
    difference, it fades away from the border.
    """
    if not hidden.any() or hidden.all():
        return layers
    cells, hidden = _continue_edges(np.moveaxis(layers, 0, -1), hidden)
    smooth = fill_holes(cells, hidden)
    scale, usual = np.maximum(cells[~hidden].std(0), 1e-6), np.median(smooth, axis=0)
    filled, turns = smooth.copy(), [i * len(hidden) // _TURNS for i in range(1, _TURNS)]
    for rows, columns, region in _regions(hidden):
        box = np.ix_(rows % len(hidden), columns)
        border = morphology.dilation(region, np.ones((2 * _BORDER + 1,) * 2, bool)) & ~hidden[box]
        inside, edge = ((rows[r], columns[c]) for r, c in map(np.nonzero, (region, border)))
        at_border = smooth[edge[0] % len(hidden), edge[1]]
        # A place that is itself hidden is the last choice.
        unseen = [int(hidden[(inside[0] - t) % len(hidden), inside[1]].sum()) for t in turns]

        def unlikeness(turn: int, at_border=at_border, inside=inside, edge=edge) -> float:
            """Mean squares of what differs at the border and, inside, from the usual iris."""
            there = smooth[(inside[0] - turn) % len(hidden), inside[1]]
            unusual = (((there - usual[inside[1]]) / scale) ** 2).mean()
            if not len(at_border):
                return float(unusual)
            turned = smooth[(edge[0] - turn) % len(hidden), edge[1]]
            # A border may keep some of a mirror image, to which no place is alike.
            off = np.minimum(np.abs(at_border - turned) / scale, _MOST_OFF)
            return float(unusual + (off**2).mean())

        candidates = [t for t, n in zip(turns, unseen, strict=True) if n == min(unseen)]
        turn = min(candidates, key=unlikeness)
        turned = smooth[np.ix_((rows - turn) % len(hidden), columns)]
        if not region.all():
            difference = fill_holes(smooth[box] - turned, region)
            if region[:, columns == hidden.shape[1] - 1].any():  # to the root: under a lid
                depth = ndimage.distance_transform_edt(region) / hidden.shape[1]
                difference = difference * np.exp(-((depth / _FADES) ** 2))[..., None]
            turned = turned + difference
        filled[box] = np.where(region[..., None], turned, filled[box])
    return np.moveaxis(filled, -1, 0)


def _continue_edges(
    cells: Float[np.ndarray, "angles radii layers"], hidden: Bool[np.ndarray, "angles radii"]
) -> tuple[Float[np.ndarray, "angles radii layers"], Bool[np.ndarray, "angles radii"]]:
    """Continue what is seen at each angle to the pupil and to the root of the iris.

    An angle at which more than twice as many cells are hidden before an edge as at a quarter of the
    angles is left out: a lid hides them.

    Returns:
        The cells, and those that are still hidden.
    """
    cells, still_hidden, seen = cells.copy(), hidden.copy(), ~hidden.all(1)
    for step in (1, -1):  # from the pupil outwards, from the root inwards
        outer, shown, remaining = cells[:, ::step], ~hidden[:, ::step], still_hidden[:, ::step]
        depth = np.argmax(shown, axis=1)  # number of hidden cells before the edge
        deepest = 2 * np.quantile(depth[seen], 0.25)
        for angle in np.flatnonzero(seen & (depth > 0) & (depth <= deepest)):
            first = depth[angle]
            beside = slice(first, first + _CONTINUED)
            outer[angle, :first] = outer[angle, beside][shown[angle, beside]].mean(0)
            remaining[angle, :first] = False
    return cells, still_hidden


def _regions(hidden: Bool[np.ndarray, "angles radii"]):
    """Rows (beyond the last is the first), columns and mask of a box about each hidden region."""
    angles, radii = hidden.shape
    # The ends of the angles meet: a region that crosses them is whole in two copies.
    label = np.asarray(measure.label(np.concatenate([hidden, hidden])))
    done = np.zeros_like(hidden)
    regions = sorted(measure.regionprops(label), key=lambda r: -r.area)
    for region in regions:
        cells = region.coords
        if done[cells[:, 0] % angles, cells[:, 1]].any():
            continue
        done[cells[:, 0] % angles, cells[:, 1]] = True
        (top, left), (bottom, right) = cells.min(0) - _BORDER, cells.max(0) + _BORDER + 1
        rows = np.arange(top, min(bottom, top + angles))
        columns = np.arange(max(left, 0), min(right, radii))
        mask = np.zeros((len(rows), len(columns)), bool)
        inside = cells[:, 0] - top < len(rows)
        mask[cells[inside, 0] - top, cells[inside, 1] - columns[0]] = True
        yield rows, columns, mask
