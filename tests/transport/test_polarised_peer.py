"""sasktran2, polarised discrete ordinates without interfaces, on a conservative and a dark slab."""

import numpy as np
import pytest

import irisjax as ij
from common import layers, quick_jit

EXITS, AZIMUTH = np.array([0.9, 0.6, 0.3, 0.1]), np.radians([0.0, 40.0, 110.0, 180.0])


@pytest.mark.peer
@pytest.mark.parametrize("albedo", [0.999999, 0.8])
def test_stokes_vectors(albedo):
    sk = pytest.importorskip("sasktran2")
    depth, cosine = 0.5, 0.6
    config = sk.Config()
    config.num_stokes, config.num_streams = 3, 40
    config.num_singlescatter_moments = 40
    config.multiple_scatter_source = sk.MultipleScatterSource.DiscreteOrdinates
    config.single_scatter_source = sk.SingleScatterSource.DiscreteOrdinates
    heights = np.linspace(0, 1000.0, 21)
    geometry = sk.Geometry1D(
        cosine, 0, 6_372_000, heights, sk.InterpolationMethod.LinearInterpolation,
        sk.GeometryType.PlaneParallel,
    )  # fmt: skip
    viewing = sk.ViewingGeometry()
    for mu, phi in zip(EXITS, AZIMUTH, strict=True):
        viewing.add_ray(sk.GroundViewingSolar(cosine, phi, mu, 200_000))
    atmosphere = sk.Atmosphere(geometry, config, numwavel=1, calculate_derivatives=False)
    atmosphere.storage.total_extinction[:] = depth / 1000.0
    atmosphere.storage.ssa[:] = albedo
    moments = atmosphere.leg_coeff
    moments.a1[0], moments.a1[2] = 1.0, 0.5
    moments.a2[2], moments.b1[2] = 3.0, np.sqrt(6.0) * 0.5
    engine = sk.Engine(config, geometry, viewing)
    theirs = engine.calculate_radiance(atmosphere)["radiance"].values[0]  # (rays, stokes), flux 1

    made = layers(0.0, depth * (1 - albedo), depth * albedo, (1.0,) * 4)
    run = quick_jit(
        lambda x: ij.RadiativeExact(60, 10, 2, process=ij.POLARISED).solve(
            x, ij.Light(cosine, ij.Directions(EXITS, AZIMUTH))
        )
    )
    ours = cosine * np.asarray(run(made).polarisation.brdf)[0, :, :3, 0]
    np.testing.assert_allclose(ours[:, 0], theirs[:, 0], rtol=1e-5)
    for k in (1, 2):
        np.testing.assert_allclose(np.abs(ours[:, k]), np.abs(theirs[:, k]), atol=1e-5 * ours.max())
