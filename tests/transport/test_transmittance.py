"""Light that leaves the iris behind, through a pigment epithelium with a melanin mass."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from next_event import fresnel, refracted

import irisjax as ij
from common import quick_jit
from irisjax.tissue.maps import check_pictured
from irisjax.tissue.pigments import extinction
from irisjax.transport.defaults import quickest

WAVES = np.array([450.0, 550.0, 650.0])
PALE = ij.Iris.of_level("low")
SOLVERS = {
    "ilit": ij.IlitExact(16, process=ij.ILIT_CORRECTED),
    "radiative": ij.RadiativeExact(28),
    "doubling": ij.AddingDoubling(20, 8),
    "polarised": ij.RadiativeExact(12, 4, 2, process=ij.POLARISED),
}
COSINE = 0.8


@functools.cache
def translucent():
    """Layers whose pigment epithelium lets light through."""
    return quick_jit(ij.Iris.layers)(PALE.replace(ipe_melanin=0.5), extinction(WAVES))


# The programs of these give the derivatives too.
WITH_SLOPES = "ilit", "radiative"


@functools.cache
def solved(name, mass):
    """One program a solver, and one for those whose pigment epithelium is black."""
    mass = mass if mass is None else np.float64(mass)
    return run(name, mass, *np.array([0.1201, 1.0, 0.0]))[0]


@functools.partial(quick_jit, static_argnums=0)
def run(name, mass, eumelanin, *way):
    """Return the solution, and the derivative of the transmittance along a direction in the space of
    both pigments; `None` in its place for solvers without derivatives.
    """

    def solve(mass, eumelanin):
        iris = PALE.replace(ipe_melanin=mass, eumelanin=eumelanin)
        found = SOLVERS[name].solve(iris.layers(extinction(WAVES)), ij.Light(COSINE))
        return found.transmitted, found

    if mass is None or name not in WITH_SLOPES:
        return solve(mass, eumelanin)[1], None
    _, slope, found = jax.jvp(solve, (mass, eumelanin), way, has_aux=True)
    return found, slope


@pytest.mark.parametrize("name", SOLVERS)
def test_energy_closes(name):
    for mass in (0.0, 0.5, 1e4):
        found = solved(name, mass)
        np.testing.assert_allclose(found.energy, 1, rtol=1e-12)
    if name != "ilit":  # whose rays, drawn anew in each layer, a clear one may guide for ever
        np.testing.assert_allclose(solved(name, 0.0).absorbed.ipe, 0, atol=1e-15)
    assert (solved(name, 0.5).transmitted < solved(name, 0.0).transmitted).all()


# An adding–doubling of its own: operators over directions that share their Snell invariants, in
# NumPy. A layer is what it sends back and on, from above and from below.


def stacked(first, second):
    r1, t1, r2, t2 = first  # from above: back, on; from below: back, on
    s1, u1, s2, u2 = second
    one = np.eye(len(r1))
    down = np.linalg.solve(one - r2 @ s1, t1)  # arrives at the second from above
    up = np.linalg.solve(one - s1 @ r2, u2)  # arrives at the first from below
    return r1 + t2 @ s1 @ down, u1 @ down, s2 + u1 @ r2 @ up, t2 @ up


def interface(cosine, n_in, n_out):
    mirror = fresnel(cosine, n_in, n_out)
    return [np.diag(x) for x in (mirror, 1 - mirror, mirror, 1 - mirror)]


def absorber(depth, cosine):
    nothing, through = np.zeros((len(cosine),) * 2), np.diag(np.exp(-depth / cosine))
    return nothing, through, nothing, through


def scatterer(absorption, scattering, cosine, weight, doublings=24):
    """A slab by doubling from the diamond scheme; Rayleigh's law in the mean over azimuth."""
    m2, n2 = cosine[:, None] ** 2, cosine[None] ** 2
    phase = 3 / 16 * (3 - m2 + (3 * m2 - 1) * n2)  # half of the phase function's mean
    depth = (absorption + scattering) / 2**doublings
    thin = scattering / 2**doublings * phase * weight[:, None] / cosine[None]  # flux into a row
    one = np.eye(len(cosine))
    gone = np.diag(depth / cosine)
    near, far = one + (gone - thin) / 2, thin / 2
    # (out_up, out_down) from (in_down, in_up), the light inside being the mean of in and out.
    whole = np.block([[near, -far], [-far, near]])
    inward = np.block([[2 * one - near, far], [far, 2 * one - near]])
    moved = np.linalg.solve(whole, inward)
    n = len(cosine)
    on, back = moved[:n, :n], moved[n:, :n]
    slab = back, on, back, on
    for _ in range(doublings):
        slab = stacked(slab, slab)
    return slab


def transmittance_apart(layers, k, cosine_outside):
    """Reflectance without the first surface's, and transmittance, at wavelength k."""
    n = layers.indices
    aqueous, abl, stroma, ipe = (float(x) for x in (n.aqueous, n.abl, n.stroma, n.ipe))
    # Directions in the stroma: two panels, crowded at both ends of each; the beam has no weight.
    x, w = np.polynomial.legendre.leggauss(40)
    u, w = (x + 1) / 2, w / 2
    critical = np.sqrt(1 - (aqueous / stroma) ** 2)
    cosine, weight = [], []
    for low, high in ((0.0, critical), (critical, 1.0)):
        cosine.append(low + (high - low) * u**2 * (3 - 2 * u))
        weight.append((high - low) * 6 * u * (1 - u) * w)
    inside = np.sqrt(1 - (1 - cosine_outside**2) * (aqueous / stroma) ** 2)
    mu = np.append(np.concatenate(cosine), inside)
    weight = np.append(np.concatenate(weight), 0.0)

    outside, in_abl, in_ipe = (refracted(mu, stroma, medium) for medium in (aqueous, abl, ipe))
    depths = layers.abl_absorption, layers.stroma_absorption, layers.stroma_scattering
    a, b, c, d = (float(x[k]) for x in (*depths, layers.ipe_absorption))
    pile = [interface(outside, aqueous, abl), absorber(a, in_abl), interface(in_abl, abl, stroma)]
    pile += [scatterer(b, c, mu, weight), interface(mu, stroma, ipe)]
    pile += [absorber(d, in_ipe), interface(in_ipe, ipe, aqueous)]
    whole = pile[0]
    for layer in pile[1:]:
        whole = stacked(whole, layer)
    back, on = whole[0][:, -1].sum(), whole[1][:, -1].sum()
    return back - pile[0][0][-1, -1], on


@pytest.mark.parametrize("k", range(3))
def test_adding_doubling_written_apart(k):
    layers = translucent()
    reflected, transmitted = transmittance_apart(layers, k, COSINE)
    for name, near in (("radiative", 1e-7), ("doubling", 2e-6)):
        found = solved(name, 0.5)
        np.testing.assert_allclose(found.transmitted[k], transmitted, rtol=near)
        np.testing.assert_allclose(found.reflectance[k], reflected, rtol=near)


@pytest.mark.parametrize("name", SOLVERS)
def test_a_thick_epithelium_is_black(name):
    thick = solved(name, 1e4)
    np.testing.assert_array_less(thick.transmitted, 1e-100)
    if name == "ilit":  # a program more; reference tables are of the others' black epithelium
        black = solved(name, None)
        assert black.transmitted is None
        np.testing.assert_allclose(thick.reflectance, black.reflectance, rtol=1e-12)


def test_polarisation_changes_little_of_it():
    polarised, scalar = (solved(n, 0.5) for n in ("polarised", "radiative"))
    shares = ((x.transmitted, *jax.tree.leaves(x.absorbed)) for x in (polarised, scalar))
    for share, without in zip(*shares, strict=True):
        np.testing.assert_allclose(share, without, rtol=1e-3)
    assert (polarised.transmitted != scalar.transmitted).all()


def test_photons_of_radiative_transfer():
    photons = ij.MonteCarlo(100_000, process=ij.DEPTH_RESOLVED)
    found = quick_jit(photons.solve)(translucent(), ij.Light(COSINE), key=jax.random.key(3))
    check_photons(found.transmitted, found.transmitted_error, found, "radiative")
    np.testing.assert_allclose(found.energy, 1, rtol=1e-12)


def check_photons(transmitted, error, found, name):
    expected = solved(name, 0.5)
    assert np.abs((transmitted - expected.transmitted) / error).max() < 4
    for kept, exact in zip(*map(jax.tree.leaves, (found.absorbed, expected.absorbed)), strict=True):
        assert (np.abs(kept - exact) < 4 * np.sqrt(exact / 1e5)).all()


@pytest.mark.parametrize("name", WITH_SLOPES)
def test_derivatives(name):
    at = np.array([0.5, 0.1])
    for way in np.eye(2):
        high, low = (run(name, *(at + h * way), *way)[0].transmitted for h in (1e-4, -1e-4))
        slope = run(name, *at, *way)[1]
        np.testing.assert_allclose(slope, (high - low) / 2e-4, rtol=1e-5)


def test_who_has_a_black_epithelium_says_so():
    solver = quickest(PALE, 1.336, ij.ILIT_2006)
    with pytest.raises(ValueError, match="black pigment epithelium; one with ipe_melanin takes"):
        solver.solve(translucent(), ij.Light(1.0))


def test_the_instrument_and_photons_of_ilit():
    iris, seen = PALE.replace(ipe_melanin=0.5), ij.Transmissometer(WAVES, cos_incidence=COSINE)
    exact = solved("ilit", 0.5)
    read = seen.reading(exact, jnp.ones(()))
    np.testing.assert_array_equal(read, exact.transmitted)
    assert read.quantity == "transmittance"
    shares = read.absorbed.total() + read.transmitted + read.mirrored
    np.testing.assert_allclose(shares + exact.reflectance, 1, rtol=1e-12)
    photons, key = ij.MonteCarlo(100_000, process=ij.ILIT_CORRECTED), jax.random.key(3)
    read = ij.transmittance(iris, WAVES, cos_incidence=COSINE, solver=photons, key=key)
    check_photons(read.values, read.standard_error, read, "ilit")
    with pytest.raises(ValueError, match="no light gets behind a black pigment epithelium"):
        ij.transmittance(PALE, WAVES)
    with pytest.raises(ValueError, match="a picture has nothing behind the iris"):
        check_pictured(iris)
    with pytest.raises(ValueError, match="transmitted light leaves behind"):
        ij.Transmissometer(WAVES, cornea="round-trip")
