r"""Robust-performance synthesis: K and D together by direct minimisation over the scalings, and G for real blocks.

For every full block i and constant values of the real blocks of size at most 1 / beta_0, the peak of mu is at least
:math:`\min(\beta_0, \| T_{ii} \|_\infty)` of that member; Parrott's bound of that norm holds for every controller.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.budget import MILLION, Budget, dense, one_thread
from robustlab.checks import number, whole
from robustlab.display import AllFields, Facts
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.frequency import default_grid
from robustlab.mu_analysis.axis.intervals import AxisCover, Piece, continuous, cover_axis, loop_axis_claims
from robustlab.mu_analysis.axis.margin import PERFORMANCE
from robustlab.mu_analysis.matrix.block_structure import project
from robustlab.mu_analysis.matrix.branch_and_bound import centre_matrix
from robustlab.mu_analysis.matrix.lower import lower_bounds
from robustlab.mu_analysis.matrix.upper import compile_kernels
from robustlab.norms import bilinear_to_continuous, bilinear_to_discrete, hinf_norm
from robustlab.norms.claims import ABOVE
from robustlab.result import Status, Table, Tabular
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.dk.riccati_level import Found, LevelSearch, grown, minimised
from robustlab.synthesis.dk.scalings import (
    FIRST_POINTS,
    DynamicScalings,
    MuCurve,
    constant_scalings,
    mu_curve,
    plant_at_level,
    proved_level,
    unit_scalings,
)
from robustlab.synthesis.hinf.hinf_synthesis import channel_gains, synthesize, trial_loop
from robustlab.synthesis.problem.certify import SHARES, certified, named_controller, with_direct_term
from robustlab.synthesis.problem.design import Synthesis, design_budget, final_status, limiting_channels
from robustlab.synthesis.problem.gamma_lower_bound import GammaBound, pointwise_bound
from robustlab.synthesis.problem.generalized_plant import (
    GeneralizedPlant,
    PlantMatrices,
    Realisation,
    as_generalized_plant,
    equilibrated,
    paths_first,
    require_performance,
)
from robustlab.synthesis.structures.controller_structures import unpacked
from robustlab.uncertainty.blocks import Block, FullBlock, as_blocks, block_slices, delta_values, structure_size
from robustlab.verification.checker import check
from robustlab.verification.claim import Outcome

# The central controller at the smallest level is ill-conditioned: the level is increased by these shares until the
# proof succeeds. The last ones are for badly scaled plants, where the controller loses digits.
BACKOFF = (1e-4, 1e-3, 1e-2, 5e-2, 0.1, 0.2, 0.3, 0.4, 0.6, 1.0)
ACCEPTED = 1e-2  # loss against the Riccati level above which the other numerical scaling is tried as well
SLACK_SHARES = (0.999, 0.8, 0.5)  # shares (of a logarithm) of the slack for slower controllers
REGULAR = 1e-6  # D12, D21 below this size in scaled units need regularisation
STATE_SHARE = 0.3  # share of the regularisation for penalties and noises on the states
AXIS_EFFORT = 1500  # effort of the checker for mu by intervals: some seconds
BELOW_ONE = 1 - 2e-6  # a level claimed to a millionth, below one
NEAR = 0.01  # relative distance to a limit, or to the start of the search, that counts as none


@dataclass(frozen=True)
class DKStep(AllFields):
    """One iterate of the search."""

    stage: str  # `"start"`, `"D-K"` (constant D), `"direct"` or `"D-G-K"`
    gamma: float  # bound of mu at all frequencies proved by the scalings of the iterate
    mu: float  # largest upper bound of mu at single frequencies, complex blocks; NaN where not computed
    order: int  # states of the controller
    work: float  # work since the start in the units of `robustlab.budget`


@dataclass(frozen=True, eq=False, kw_only=True)
class DKSynthesis(Tabular, Synthesis):
    """A robust-performance design; ``gamma`` bounds the peak of mu of ``closed_loop`` over all frequencies.

    ``gamma < 1`` proves stability and a gain below one for every Delta of the structure with ``|Delta| <= 1``.
    """

    quantities = dict.fromkeys(("lower", "frequency", "scaled_level", "start_mu"), float)
    saved = ("lower", "frequency", "delta", "scaled_level", "scalings", "history", "start_mu", "lower_bound", "why")

    blocks: tuple[Block, ...]  # the structure of mu, performance block included
    lower: float  # of the peak of mu, attained by `delta` at `frequency`; 0 where none was found
    frequency: float  # in rad/s, of `lower`, or of the largest upper bound where `lower` is zero
    delta: dict[str, Any]  # critical perturbation there by block name, of size `1 / lower`; empty where none was found
    scalings: DynamicScalings  # D(s), G(s) of K's design; of a discrete plant in `s = (2/dt) (z - 1)/(z + 1)`
    scaled_level: float  # bound proved by `scalings` through the norm of the scaled loop
    # Proof by constant D, G on frequency intervals that cover the axis (that of the continuous image of a discrete
    # loop); empty where `scaled_level` is the smaller bound.
    pieces: tuple[Piece, ...]
    history: tuple[DKStep, ...]
    start_mu: float  # largest mu, at single frequencies, of the first controller: of H-infinity synthesis, or K0
    lower_bound: GammaBound  # of mu for every stabilising controller; see `mu_floor`
    why: str  # one sentence: the decrease from `start_mu`, and the reason why mu is not smaller, if it is known

    def _gamma_text(self) -> str:
        return f"{self.gamma:.6g} (mu is at most this at all frequencies)"

    def facts(self) -> Facts:
        rows = super().facts()
        text = f"{self.lower:.6g} at {self.frequency:.4g} rad/s" if self.lower > 0 else "none found"
        orders = ", ".join(f"{b.name} {o}" for b, o in zip(self.blocks, self.scalings.orders, strict=True) if o)
        return [
            rows[0],
            ("peak of mu, lower bound", text),
            ("no controller below", f"{self.lower_bound.value:.6g}, {self.lower_bound.known}"),
            ("why not less", self.why),
            *rows[1:5],
            ("orders of the scalings", orders or "constant"),
            ("iterates", f"{len(self.history)}, from {self.history[0].gamma:.6g}"),
            *rows[5:],
        ]

    def table(self) -> Table:
        columns = {key: [getattr(step, key) for step in self.history] for key in ("stage", "gamma", "mu", "order")}
        return Table(("iterate", range(1, len(self.history) + 1)), columns)

    def to_json(self) -> dict[str, Any]:
        intervals = [(p.low, p.high, p.beta) for p in self.pieces]
        return super().to_json() | {"blocks": [b.name for b in self.blocks], "intervals": intervals}


def mu_floor(
    plant: PlantMatrices, blocks: Sequence[Block], gamma: float, delta: Mapping[str, Any], dt: float = 0.0
) -> GammaBound:
    """Return a lower bound, at most ``gamma``, of the peak of mu under every stabilising controller."""
    real = np.array([b.interval is not None for b in blocks])
    start = np.array([float(delta.get(b.name, 0.0)) if r else 0.0 for b, r in zip(blocks, real, strict=True)])
    best = _of_member(plant, blocks, np.zeros(len(blocks)), dt)
    if not gamma > 0:
        return replace(best, value=0.0)
    largest = float(np.abs(start).max(initial=0.0))
    member = start / (gamma * largest) if largest else start
    found = _of_member(plant, blocks, member, dt)
    for k in np.flatnonzero(real):  # one sweep over neighbouring corners
        for value in (1 / gamma, -1 / gamma):
            other = member.copy()
            other[k] = value
            tried = _of_member(plant, blocks, other, dt)
            if tried.value > found.value:
                member, found = other, tried
    if found.value > best.value:
        values = ", ".join(f"{b.name} {v:+.3g}" for b, v in zip(blocks, member, strict=True) if v)
        best = replace(found, known=f"{found.known}, of the member {values} alone")
    return replace(best, value=min(best.value, gamma))


def _of_member(plant: PlantMatrices, blocks: Sequence[Block], values: Array, dt: float) -> GammaBound:
    """Return the largest bound of the blocks' own channels for these values of the real blocks."""
    best = GammaBound(0.0, "no block's own channels keep mu from zero", True)
    p = _closed(plant, centre_matrix(blocks, values)) if values.any() else plant
    if p is None:
        return best
    for block, (w, z) in zip(blocks, block_slices(blocks), strict=True):
        if block.interval or (block.d_order > 1 and block.rows > 1):
            continue  # mu of these blocks is not a norm
        part = replace(p, B1=p.B1[:, w], D21=p.D21[:, w], C1=p.C1[z], D12=p.D12[z], D11=p.D11[z, w])
        bound = pointwise_bound(part, [paths_first(part), equilibrated(part)], dt)
        if bound.value > best.value:
            best = replace(bound, known=f"{block.name!r} alone, {bound.known}")
    return best


def _closed(p: PlantMatrices, delta: Array) -> PlantMatrices | None:
    """Return the plant with w + delta z in place of w, without the resulting D22; None: ill-posed."""
    loop = np.eye(len(p.C1)) - p.D11 @ delta
    if np.linalg.cond(loop) > 1e10:
        return None
    (A, B, C, D), n_w, n_z = p.whole(), p.B1.shape[1], len(p.C1)
    through = delta @ np.linalg.inv(loop)
    into, out = np.vstack([B[:, :n_w], D[:, :n_w]]) @ through, np.hstack([C[:n_z], D[:n_z]])
    moved, n = np.block([[A, B], [C, D]]) + into @ out, len(A)
    return PlantMatrices.of(Realisation(*unpacked(moved, n)), n_w, n_z)


def why_not_less(smallest: float, start_mu: float, floor: float, blocks: Sequence[Block]) -> str:
    """Return one sentence with the decrease from the first controller and the reason why mu is not smaller."""
    gained = 1 - smallest / start_mu if start_mu > 0 else 0.0
    text = f"mu of the first controller is {start_mu:.4g}, the smallest proved {smallest:.4g}"
    text += f" ({gained:.1%} less)" if gained > NEAR else ": D-K gains nothing over it"
    if smallest <= floor * (1 + NEAR):
        return f"{text}; it is at the limit of every controller"
    rest = f"any controller has at least {floor:.4g}"
    if len(blocks) == 1 and not blocks[0].interval and blocks[0].d_order == 1:
        return f"{text}; one full block: mu is the norm that H-infinity makes smallest, D has nothing to change; {rest}"
    return f"{text}; {rest}; values between are not decided, because the search is local"


@dataclass(frozen=True, eq=False)
class Iterate:
    """A controller with the level that its scalings prove."""

    K: StateSpaceModel  # for the given plant, D22 included
    loop: StateSpaceModel  # the closed loop rebuilt from it, mapped to continuous time where the plant is discrete
    scalings: DynamicScalings  # D, G whose scaled loop proves `level`
    level: float  # upper bound of mu at all frequencies


class RobustProblem:
    """Plant, structure and regularisation of a robust-performance synthesis."""

    def __init__(self, plant: GeneralizedPlant, budget: Budget) -> None:
        self.plant, self.budget = plant, budget
        self._continuous = plant.continuous()
        self.bare = self._continuous.matrices()
        self.matrices = self.bare
        self.scale = paths_first(self.bare)
        self._regular = min(self.scale.apply(self.bare).direct_sizes) > REGULAR

    def search(self, scalings: DynamicScalings, alternative: bool = False) -> LevelSearch:
        """Return the level search of scalings of this form; ``alternative``: with the other numerical scaling."""
        whole, sizes = self.matrices.whole(), self.matrices.sizes

        def at(theta: AnyArray, beta: float) -> PlantMatrices:
            return plant_at_level(whole, sizes, scalings.with_parameters(theta), beta)

        scaled = at(scalings.parameters(), 1.0)
        units = equilibrated(scaled) if alternative else paths_first(scaled)
        return LevelSearch(at, units, self.budget)

    def solve(self, scalings: DynamicScalings, beta: float) -> Iterate | None:
        """Return the controller of smallest proved level among those a little above the known smallest level."""
        best: Iterate | None = None
        for alternative in (False, True):
            search = self.search(scalings, alternative)
            for share in BACKOFF:
                K = search.controller(scalings.parameters(), beta * (1 + share))
                found = None if K is None else self.closed(K, scalings, beta)
                if found is not None and (best is None or found.level < best.level):
                    best = found
                if best is not None and best.level <= beta * (1 + share) * (1 + 1e-3):
                    break
            if best is not None and best.level <= beta * (1 + ACCEPTED):
                break
        return best

    def relaxed(self, iterate: Iterate, limit: float) -> Iterate:
        """Return the same scalings with the controller of slowest poles whose proved level is at most ``limit``."""
        if not iterate.level:  # the loop is zero
            return iterate

        def fastest(of: Iterate) -> float:
            return float(np.abs(of.K.poles()).max(initial=0.0))

        search, best = self.search(iterate.scalings), iterate
        for share in SLACK_SHARES:
            level = iterate.level * (limit / iterate.level) ** share
            K = search.controller(iterate.scalings.parameters(), level)
            found = None if K is None or self.budget.over else self.closed(K, iterate.scalings, iterate.level)
            if found is not None and found.level <= limit and fastest(found) < fastest(best):
                best = found
        return best

    def closed(self, K: StateSpaceModel, scalings: DynamicScalings, guess: float) -> Iterate | None:
        """Return the iterate of a controller for the continuous plant without D22; None where it is unstable."""
        try:
            full = with_direct_term(K, self._continuous.D22)
            if self.plant.model.is_discrete:
                full = bilinear_to_discrete(full, self.plant.model.dt)
        except (InputError, NoTrustworthyNumber):
            return None
        return self.proved(full, scalings, guess)

    def proved(self, K: StateSpaceModel, scalings: DynamicScalings, guess: float) -> Iterate | None:
        """Return the iterate of a controller for the given plant; None where it is unstable or proves no level."""
        try:
            K = named_controller(K, self.plant.measurements, self.plant.controls, K.dt)
            loop = self.plant.close(K)
            if not loop.is_stable():
                return None
            loop = _mapped(loop)
            self.budget.spend(dense(loop.n_states + scalings.n_states, 20 * 10 if scalings.mixed else 10))
            level, _ = proved_level(loop, scalings, guess)
        except (InputError, NoTrustworthyNumber, np.linalg.LinAlgError):
            return None
        return Iterate(K, loop, scalings, level) if np.isfinite(level) else None

    def certified(
        self, iterate: Iterate, blocks: tuple[Block, ...], cover: AxisCover
    ) -> tuple[float, tuple[Piece, ...], str]:
        """Prove mu by the checker: the level of the cover's intervals, or else that of the iterate's scalings."""
        plant, K, doubt, best = self.plant, iterate.K, "", iterate.level
        if cover.pieces and not cover.open and cover.beta < iterate.level:
            best, doubt = cover.beta, "pieces of the proof could not be joined"
            for claim in loop_axis_claims(plant.model, K, blocks, cover.beta * ABOVE, cover.pieces):
                found = check(claim, effort=AXIS_EFFORT)
                if found.outcome is Outcome.PROVED:
                    return cover.beta, tuple(cover.pieces), ""
                doubt = f"not proved in ball arithmetic of P and K as they are: {found.where}"
        # The norm of the scaled loop: with G at a slightly higher level, where it is below one; without G at level one.
        mixed = iterate.scalings.mixed
        beta = iterate.level * (1 + SHARES[0]) if mixed else 1.0
        scaled, mapped = self._scaled(iterate.scalings, beta), _mapped(K)
        proof = certified(scaled, mapped, hinf_norm(scaled.close(mapped)), BELOW_ONE if mixed else None)
        open_doubt = proof.doubt
        if plant.model.is_discrete:  # the image of K differs from K by the rounding of the map
            open_doubt = open_doubt or certified(plant, K, hinf_norm(plant.close(K))).doubt
        if not open_doubt:
            return (beta * max(proof.gamma, 1.0) if mixed else proof.gamma), (), ""
        return max(best, beta * proof.gamma), (), open_doubt or doubt

    def _scaled(self, scalings: DynamicScalings, beta: float) -> GeneralizedPlant:
        whole = plant_at_level(self.bare.whole(), self.bare.sizes, scalings, beta).whole()
        whole.D[-self.plant.n_meas :, -self.plant.n_con :] = self._continuous.D22
        return GeneralizedPlant(StateSpaceModel(*whole), self.plant.n_meas, self.plant.n_con)

    def regularise(self, iterate: Iterate, share: float) -> None:
        """Add weak penalties on u and x and noises on y and x if the plant is singular for the Riccati equations."""
        if self._regular:
            return
        self.budget.spend(dense(iterate.loop.n_states + iterate.scalings.n_states, 4))
        _, _, n_u, _, n_y = self.bare.sizes
        out, into = 1 / self.scale.states, self.scale.states * self.scale.rate
        try:
            wide = self.bare.with_channels(1.0, 1.0, out, into)
            wide = plant_at_level(wide.whole(), wide.sizes, iterate.scalings, 1.0)
            K = with_direct_term(_mapped(iterate.K), -self._continuous.D22)
        except (InputError, NoTrustworthyNumber):
            return
        gains = channel_gains(trial_loop(wide, Realisation.of(K)), self.bare.sizes)
        if gains is None:
            return
        # Each channel gets about this share of the gain of the scaled loop; the smallest level rises by its square.
        level = share * iterate.level
        u, y, x_out, x_in = (level / np.maximum(g, level) for g in gains)  # at most one
        x_out, x_in = STATE_SHARE * x_out * out, STATE_SHARE * x_in * into
        self.matrices = self.bare.with_channels(u / np.sqrt(n_u), y / np.sqrt(n_y), x_out, x_in)


def _mapped(model: StateSpaceModel) -> StateSpaceModel:
    return bilinear_to_continuous(model) if model.is_discrete else model


WORK = 120 * MILLION  # the usual work at effort 1
START_SHARE = 0.25  # share for the H-infinity start; larger: a better first controller, less time for the rest
SEARCH_END = 0.8  # share at which the whole search ends; the rest is for the proof
RELAXATION = 0.25  # share of that rest for the search for slower controllers
PROGRESS = 2e-3  # relative progress of an enlargement of the scalings below which it gained nothing
FALLS = 2  # consecutive enlargements of that kind that end the search
NEAR_PEAK = 0.9  # sections of all factors are spread over the band in which mu of the first loop is above this share
MAX_SECTIONS = 8  # of a factor
FEW_SECTIONS = 3  # in every factor, up to which they are placed one by one as well
BAND_LEVEL = 0.3  # new sections are placed where mu is above this share of its peak ...
BEYOND = 30.0  # ... and up to this factor beyond; larger: slower and faster sections
PROOF_ACCURACY = 1e-3  # of the proof by intervals; smaller: more intervals
START_POINTS, LOWER_POINTS = 16, 4  # frequencies of mu of real blocks of the first loop, and of the last lower bound
FINE = 0.03  # share of the loop's gain that regularisation may cost; smaller: stiffer


@error_context("synth dk")
def dk(
    P: Any,
    blocks: Any = None,
    n_meas: int | None = None,
    n_con: int | None = None,
    *,
    K0: Any = None,
    direct: bool = True,
    mixed: bool = True,
    max_order: int | None = None,
    order_rel: float = 0.01,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> DKSynthesis:
    r"""Compute a controller ``u = K y`` (positive feedback) with a small peak of mu of the closed loop.

    .. math:: \min_K \sup_\omega \mu_\Delta (F_l(P, K)(j \omega)) \le
        \min_{K, D, G} \; \beta: \; \| D_z F_l(P, K) D_w^{-1} G_M / \beta - G_N \|_\infty \le 1

    *D-K*: H-infinity synthesis, the constant D that is best for its loop, and then K and D together: gamma is minimised
    over the parameters of D, of which the two Riccati equations give K. *Direct* continues with D(s) of growing order;
    *D-G-K* with D(s) and G(s) where blocks are real. Every controller is evaluated on the loop rebuilt from it, which
    must be stable, and by the bound that its scalings prove at all frequencies. Doyle 1985; Balas, Doyle, Glover,
    Packard, Smith, *mu-Analysis and Synthesis Toolbox* (1993); Young, "Controller design with real parametric
    uncertainty" (1996).

    Parameters
    ----------
    P
        Generalised plant with inputs [w_Delta; w; u] and outputs [z_Delta; z; y]: `GeneralizedPlant`,
        StateSpaceModel, UncertainModel, or python-control object; continuous or discrete.
    blocks
        Blocks of Delta, or rows in the notation of mussv. Where some w *and* some z belong to no block, these get a
        full complex block ``"performance"``; where blocks cover all w and z, they are the whole structure. None: the
        blocks of P, an UncertainModel or a `GeneralizedPlant` made from one. A repeated scalar gets a diagonal rational
        D times a constant triangular matrix.
    K0
        Stabilising controller to start from (StateSpaceModel, Controller, any Synthesis); default: that of `hinf`.
    direct, mixed
        False keeps D and G constant over the frequency; False treats real blocks as complex.
    max_order
        Largest order of the controller; default: three times the states of P, at least 24 more.
    order_rel
        Relative increase over the smallest level that is accepted for a controller of lower order, and then for one
        with slower poles. 0 requires the smallest level, whose controller is often extremely fast.
    n_meas, n_con, time_limit, effort, progress
        As for `robustlab.hinf`; effort 1 is one to two minutes of one core at most.

    Returns
    -------
    DKSynthesis
        The design; ``gamma`` is an upper bound of mu at all frequencies, by the norm of the scaled loop or, where these
        are tighter, by proved intervals.

    Raises
    ------
    InputError, NoTrustworthyNumber
        Blocks that do not fit P, no blocks at all (use `hinf`), a range that is not symmetric (see `centred`), a K0
        that does not fit or does not stabilise. A mode that no controller can stabilise, or no verified controller.

    Examples
    --------
    >>> from robustlab.uncertainty.blocks import ComplexScalar
    >>> A, B = [[-1.0]], [[0.5, 1.0, 1.0]]
    >>> C, D = [[0.0], [1.0], [1.0]], [[0, 0, 1], [0, 0, 0], [0, 1, 0]]
    >>> design = dk(StateSpaceModel(A, B, C, D), [ComplexScalar("gain")], 1, 1, direct=False)
    >>> design.status.value, design.lower <= design.gamma < 1
    ('certified', True)
    """
    plant, all_blocks = structure_with_performance(P, blocks, n_meas, n_con)
    number("synth dk: order_rel", order_rel, at_least=0, below=1)
    budget = design_budget("synth dk", effort, time_limit, WORK)
    n = plant.model.n_states
    most = max(3 * n, n + 24) if max_order is None else whole("synth dk: max_order", max_order, n)  # P has n states
    with one_thread(), np.errstate(over="ignore", invalid="ignore"):  # results are verified independently
        compile_kernels()
        search = _Search(plant, all_blocks, budget, most, mixed, progress or (lambda _: None))
        search.start(K0)
        search.descend(direct)
        return search.finished(order_rel)


def structure_with_performance(
    P: Any, blocks: Any, n_meas: int | None, n_con: int | None
) -> tuple[GeneralizedPlant, tuple[Block, ...]]:
    """Return the plant and the structure on all of its w and z; see `dk` for the rule of the performance block."""
    where = "synth dk"
    plant = as_generalized_plant(P, n_meas, n_con, where)
    if blocks is None:
        require_performance(plant, where)
    given = plant.blocks if blocks is None else as_blocks(blocks)
    if not given:
        raise InputError(where, "no uncertainty blocks", "at least one", "use hinf for a plant without uncertainty")
    for block in given:
        if not block.is_symmetric:
            found = "a range that is wider on one side ({:g} .. {:g})".format(*block.ends)
            expected, hint = "a range that is symmetric around its nominal value", "uncertain.centred() moves it there"
            raise InputError(f"{where}: block {block.name!r}", found, expected, hint)
    n_w, n_z, (q, p) = plant.n_w, plant.n_z, structure_size(given)
    if (q, p) == (n_w, n_z):
        return plant, given
    if q >= n_w or p >= n_z:
        found = f"blocks of {q} inputs w and {p} outputs z for a plant with {n_w} w and {n_z} z"
        expected = "blocks that cover all of both, or leave some of both for the performance block"
        raise InputError(where, found, expected)
    if PERFORMANCE in [b.name for b in given]:
        raise InputError(where, f"a block is called {PERFORMANCE!r}", "another name for it")
    return plant, (*given, FullBlock(PERFORMANCE, n_w - q, n_z - p))


class _Search:
    """The iterates of the search; every stage adds to them."""

    def __init__(
        self, plant: GeneralizedPlant, blocks: tuple[Block, ...], budget: Budget, max_order: int, mixed: bool,
        say: Callable[[str], None],
    ) -> None:  # fmt: skip
        self.plant, self.budget, self.whole, self.max_order, self.say = plant, budget, budget.left, max_order, say
        self.mixed = mixed and any(b.g_basis() for b in blocks)
        self.real, self.blocks = blocks, tuple(b.as_complex() for b in blocks)
        self.search = budget.share(SEARCH_END)
        self.problem = RobustProblem(plant, self.search)
        self.max_states = max_order - plant.model.n_states  # of the scalings
        self.iterates: list[Iterate] = []
        self.history: list[DKStep] = []

    @property
    def late(self) -> bool:
        return self.problem.budget.over

    @property
    def best(self) -> Iterate:
        return min(self.iterates, key=lambda iterate: iterate.level)

    def start(self, K0: Any) -> None:
        """Keep K0, or else the H-infinity controller of the plant without scalings."""
        if K0 is None:
            K = synthesize(self.plant, "hinf", 1.0, self.search.share(START_SHARE)).K
        else:
            K = self.plant.fitted(K0, "synth dk: K0")
            if K.dt != self.plant.model.dt:
                raise InputError("synth dk: K0", f"dt is {K.dt:g} s", f"{self.plant.model.dt:g} s, as the plant")
        found = self.problem.proved(K, unit_scalings(self.blocks), 1.0)
        if found is None:
            if K0 is not None:
                raise InputError("synth dk: K0", "a loop that is not stable", "a controller that stabilises P")
            raise NoTrustworthyNumber("synth dk", "the H-infinity design could not be verified in the loop")
        self._keep(found, "start")
        self.curve = curve = mu_curve(found.loop, self.blocks, self.problem.budget)
        self.start_mu = curve.peak  # largest mu at single frequencies
        if self.mixed:  # mu of real blocks where complex mu is largest
            top = np.sort(curve.omega[np.argsort(-curve.levels)[:START_POINTS]])
            self.start_mu = mu_curve(found.loop, self.real, Budget(0.0), top).peak

    def descend(self, dynamic: bool) -> None:
        """Minimise over constant D, then over D(s) with one section more in every factor each time, or section by
        section where these are too many; for real blocks over D and G, section by section.
        """
        first, constant = self.best, constant_scalings(self.curve, self.blocks)
        refitted = self.problem.proved(first.K, constant, first.level)
        if refitted is not None and refitted.level < first.level:
            self._keep(refitted, "D-K", self.curve.peak)
        constant = self.best.scalings  # that, or D = I
        self.problem.regularise(self.best, FINE)
        found = minimised(self.problem.search, constant, self.best.level)
        levels = [self._taken(found, "D-K")]
        self.problem.regularise(self.best, FINE)
        constant = constant if found is None else found[0]
        if not dynamic:
            return
        if self.mixed:
            pairs = zip(constant.parts, self.real, strict=True)
            parts = (replace(part, g=((),) * block.rows if block.g_basis() else ()) for part, block in pairs)
            self._grow(DynamicScalings(self.real, tuple(parts)), "D-G-K")
            return
        low, high = np.log(self._band(NEAR_PEAK))
        few = False  # sections fit the largest order: then their places decide
        for k in range(1, MAX_SECTIONS + 1):
            scalings = constant.spread((low + (high - low) * (np.arange(k) + 0.5) / k).tolist())
            few = scalings.n_states > self.max_states and k <= FEW_SECTIONS
            if scalings.n_states > self.max_states or self._settled(levels):
                break
            levels.append(self._taken(minimised(self.problem.search, scalings, self.best.level), "direct"))
        if few or levels[-1] > min(levels) * (1 + PROGRESS):  # other local minima each time
            self._grow(constant, "direct")

    def _grow(self, scalings: DynamicScalings, stage: str) -> None:
        """Minimise and enlarge the scalings by one section in turn until this gains little."""
        low, high = self._band(BAND_LEVEL)
        found = None if self.late else minimised(self.problem.search, scalings, self.best.level)
        levels = [np.inf]
        while found is not None:
            levels.append(self._taken(found, stage))
            if self._settled(levels):
                break
            larger = grown(self.problem.search, *found, (low / BEYOND, high * BEYOND), self.max_states)
            found = None if larger is None else minimised(self.problem.search, larger, found[1])

    def _taken(self, found: Found | None, stage: str) -> float:
        """Keep the controller of minimised scalings, and return their level; inf: none."""
        if found is None or (self.late and found[1] >= self.best.level):
            return np.inf
        iterate = self.problem.solve(*found)
        if iterate is not None:
            self._keep(iterate, stage)
        return found[1]

    def _settled(self, levels: list[float]) -> bool:
        """Return whether the last enlargements gained little, or the work is spent."""
        return self.late or min(levels[-FALLS:]) > min(levels[:-FALLS], default=np.inf) * (1 - PROGRESS)

    def _band(self, share: float) -> tuple[float, float]:
        """Return the lowest and the highest frequency (rad/s) at which mu of the first loop is above this share."""
        high = self.curve.omega[self.curve.levels >= share * self.curve.peak]
        return float(high[0]), float(high[-1])

    def _keep(self, iterate: Iterate, stage: str, mu: float = float("nan")) -> None:
        self.iterates.append(iterate)
        work = self.whole - self.budget.left
        self.history.append(DKStep(stage, iterate.level, mu, iterate.K.n_states, work))
        self.say(f"iteration {len(self.history)} ({stage}): mu <= {iterate.level:.4f}, {iterate.K.n_states} states")

    def _chosen(self, order_rel: float) -> Iterate:
        """Return the iterate of lowest order whose level is at most ``order_rel`` above the smallest."""
        fitting = [i for i in self.iterates if i.K.n_states <= self.max_order] or self.iterates
        limit = min(i.level for i in fitting) * (1 + order_rel)
        return min((i for i in fitting if i.level <= limit), key=lambda i: (i.K.n_states, i.level))

    def finished(self, order_rel: float) -> DKSynthesis:
        """Return the design of the iterate of lowest order close to the best, with the tighter of two proofs."""
        self.problem.budget, best = self.budget.share(RELAXATION), self.best
        chosen = self.problem.relaxed(self._chosen(order_rel), best.level * (1 + order_rel))
        blocks = self.real if self.mixed else self.blocks
        # The proof by intervals comes last: it takes the remaining budget.
        curve = self._last_curve(chosen, blocks)
        lower, delta, omega = _lower(curve, blocks)
        loop, cover = self.plant.close(chosen.K), AxisCover()
        if curve.peak * (1 + PROOF_ACCURACY) < chosen.level:
            peaks = curve.omega[np.argsort(-curve.levels)[:8]]
            options: Any = {"first": peaks, "budget": self.budget, "accuracy": PROOF_ACCURACY}
            cover = cover_axis(continuous(chosen.loop), blocks, curve.peak, **options)
        gamma, pieces, doubt = self.problem.certified(chosen, blocks, cover)
        if lower > gamma * (1 + 1e-6):
            raise NoTrustworthyNumber("synth dk", f"lower bound {lower:.9g} of mu above the proved {gamma:.9g}")
        frequency = float(2 / loop.dt * np.arctan(omega * loop.dt / 2)) if loop.is_discrete else omega
        smallest = min(gamma, best.level)
        floor = mu_floor(self.problem.bare, blocks, smallest, delta, loop.dt)
        how = "constant D, G on intervals that cover the axis" if pieces else "the norm of the scaled loop"
        parts = [doubt or f"loop of P and K is stable; mu bound proved in ball arithmetic at all frequencies by {how}"]
        if chosen is not best and chosen.level > best.level:
            least = f"the smallest level {best.level:.6g} ({best.K.n_states} states)"
            parts.append(f"lowest order within {order_rel:.1%} of {least}")
        status = Status.INACCURATE if doubt else Status.CERTIFIED
        status, reason = final_status(status, parts, self.budget, "a smaller mu")
        return DKSynthesis(
            K=chosen.K, gamma=gamma, closed_loop=loop, status=status, reason=reason,
            limit=limiting_channels(loop, frequency), plant=self.plant, method="dk", blocks=blocks,
            lower=min(lower, gamma), frequency=frequency, delta=delta, scalings=chosen.scalings,
            scaled_level=chosen.level, pieces=pieces, history=tuple(self.history), start_mu=self.start_mu,
            lower_bound=floor, why=why_not_less(smallest, self.start_mu, floor.value, blocks),
        )  # fmt: skip

    def _last_curve(self, chosen: Iterate, blocks: tuple[Block, ...]) -> MuCurve:
        """Return the curve of mu; without work left only around the peak of the scaled loop."""
        peak = proved_level(chosen.loop, chosen.scalings, chosen.level)[1].frequency
        around = peak * np.geomspace(0.8, 1.25, 5) if 0 < peak < np.inf else np.array([1e-6, 1e-3, 1.0])
        grid = [] if self.budget.over else default_grid(chosen.loop, FIRST_POINTS, 1.0)
        return mu_curve(chosen.loop, blocks, self.budget.share(0.5), np.union1d(grid, around))


def _lower(curve: MuCurve, blocks: tuple[Block, ...]) -> tuple[float, dict[str, Any], float]:
    """Return the largest attained lower bound at the frequencies of the largest upper bounds."""
    top = np.argsort(-curve.levels)[:LOWER_POINTS]
    found = lower_bounds(curve.response[top], blocks, restarts=4, steps=24)
    best = max(range(len(found)), key=lambda k: found[k][0])
    value, delta = found[best]
    if delta is None:
        return 0.0, {}, float(curve.omega[top[0]])
    return value, delta_values(blocks, project(blocks, delta)), float(curve.omega[top[best]])
