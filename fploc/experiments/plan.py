"""What a preset asks for: which chains are trained and what is scored, in order."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from fploc.evaluation.protocols import POOLED_SITES, Targets, can_pool, protocol_of
from fploc.experiments.preset import VARIANT, Preset
from fploc.sites.site import Site

LEARNED_METHODS = ("gnn", "gnn-fpdnn")
SEES_THE_PLAN = "gnn-fpdnn"
SEEN, ZERO_SHOT = "seen", "zero-shot"
TRAINED_ELSEWHERE = ("multi-device",)
HEADLINE_PLAN = "real"
SEEN_ONLY = ("knn",)
"""Fingerprints know no place that they were not taken at."""
COMPARED_EVERYWHERE = ("trilateration", "nls-onesided", *LEARNED_METHODS)
"""Rivals learn nothing of a target, so that all of them are compared under two protocols; in the other ones the
paper's and the strongest one without learning stand beside the networks."""
WITH_ALL_RIVALS = (SEEN, ZERO_SHOT)
CALIBRATIONS, EQUIPMENT = "calibrations", "equipment"


@dataclass(frozen=True)
class Learning:
    """One chain to train: GNN and FPDNN for a target.

    Args:
        protocol: What it may learn from.
        target: Site that it is for.
        seed: Of the training.
        ablation: What is changed; empty for nothing.
    """

    protocol: str
    target: str
    seed: int
    ablation: str = ""

    @property
    def name(self) -> str:
        """Name of its stage."""
        changed = f"{self.ablation}--" if self.ablation else ""
        return f"train--{changed}{self.protocol}--{self.target}--seed-{self.seed}"


@dataclass(frozen=True)
class Scoring:
    """One thing to score: a method at a site, as one run of the log.

    Args:
        method: Name of the method.
        protocol: Name of the protocol.
        site: Target.
        seed: Of the training.
        ablation: What was changed in it; empty for nothing.
        plan: That the method sees.
        thin: Every so many-th interval.
        study: What is varied around it, ``CALIBRATIONS`` or ``EQUIPMENT``; empty for nothing.
    """

    method: str
    protocol: str
    site: str
    seed: int
    ablation: str = ""
    plan: str = HEADLINE_PLAN
    thin: int = 1
    study: str = ""

    @property
    def name(self) -> str:
        """Name of its stage and file."""
        special = [
            self.ablation,
            f"plan-{self.plan}" if self.plan != HEADLINE_PLAN else "",
            f"thin-{self.thin}" if self.thin != 1 else "",
            f"study-{self.study}" if self.study else "",
        ]
        return VARIANT.join(
            [self.protocol, self.site, self.method, *filter(None, special), f"seed-{self.seed}"]
        )


def methods_for(protocol: str, preset: Preset) -> list[str]:
    """Return those of a preset's methods that a protocol is run with."""
    if protocol not in WITH_ALL_RIVALS:
        return [one for one in preset.methods if one in COMPARED_EVERYWHERE]
    return [one for one in preset.methods if protocol == SEEN or one not in SEEN_ONLY]


def is_headline(scoring: Scoring, preset: Preset) -> bool:
    """Return whether a scoring is plain: nothing changed, its own plan, least thinned, the first seed."""
    plain = (scoring.ablation, scoring.study, scoring.plan, scoring.thin, scoring.seed)
    return plain == ("", "", HEADLINE_PLAN, preset.thins[0], preset.seeds[0])


def needed_sites(preset: Preset, targets: Sequence[str] | None) -> list[str]:
    """Return the public sites that a preset runs on, sites to learn from together included."""
    named = (
        list(targets) if targets is not None else [one for own in preset.protocols.values() for one in own]
    )
    pooled = POOLED_SITES if any(protocol_of(name).pools for name in preset.protocols) else ()
    lent = [plan for plan in preset.plans if plan in POOLED_SITES]
    return list(dict.fromkeys([*named, *pooled, *lent]))


def chosen_protocols(
    preset: Preset, source: str, targets: Sequence[str] | None, there: Sequence[str]
) -> dict[str, list[str]]:
    """Return the sites of each protocol that can be had.

    Args:
        preset: Names the protocols and their sites.
        source: Site that is learned from.
        targets: Sites to test on instead of the preset's; None keeps these.
        there: Packed sites.
    """
    chosen = {}
    for name, own in preset.protocols.items():
        kind = protocol_of(name, source).targets
        if kind is Targets.SOURCE:
            sites = [source]
        elif targets is None:
            sites = list(own)
        elif kind in (Targets.OTHERS, Targets.ELSEWHERE):
            sites = [site for site in targets if protocol_of(name, source).admits(site)]
        else:
            sites = [site for site in own if site in targets]
        usable = [site for site in sites if site in there]
        if usable:
            chosen[name] = usable
    return chosen


def without_lonely(
    protocols: Mapping[str, Sequence[str]], source: str, there: Sequence[Site]
) -> dict[str, list[str]]:
    """Return protocols without the sites that too few others are there to pool for.

    Args:
        protocols: Sites of each protocol.
        source: Site that is learned from.
        there: Packed sites.
    """
    by_name = {site.name: site for site in there}

    def usable(name: str, site: str) -> bool:
        protocol = protocol_of(name, source)
        return not protocol.pools or can_pool(protocol.sources(by_name[site], there))

    left = {name: [site for site in sites if usable(name, site)] for name, sites in protocols.items()}
    return {name: sites for name, sites in left.items() if sites}


def learnings(preset: Preset, protocols: Mapping[str, Sequence[str]], source: str) -> Iterator[Learning]:
    """Yield every chain to train, those that others start from first."""
    for seed in preset.seeds:
        for protocol, sites in protocols.items():
            if protocol not in TRAINED_ELSEWHERE:
                for site in sites:
                    yield Learning(protocol, site, seed)
    ablated = [site for site in preset.ablation_targets if site in protocols.get(ZERO_SHOT, ())]
    if not ablated:
        return
    for seed in preset.ablation_seeds:
        for ablation in preset.ablations:
            if preset.variant(ablation).streams != "virtual":
                yield Learning(SEEN, source, seed, ablation)
            for site in ablated:
                yield Learning(ZERO_SHOT, site, seed, ablation)


def scorings(preset: Preset, protocols: Mapping[str, Sequence[str]]) -> Iterator[Scoring]:
    """Yield everything to score."""
    for protocol, sites in protocols.items():
        for site in sites:
            for method in methods_for(protocol, preset):
                seeds = preset.seeds if method in LEARNED_METHODS else preset.seeds[:1]
                for seed in seeds:
                    for thin in preset.thins if protocol == ZERO_SHOT else preset.thins[:1]:
                        yield Scoring(method, protocol, site, seed, thin=thin)
    yield from _studies(preset, protocols.get(ZERO_SHOT, ()))
    for site in [one for one in preset.ablation_targets if one in protocols.get(ZERO_SHOT, ())]:
        for seed in preset.seeds:
            for plan in (one for one in preset.plans if one != site):
                yield Scoring(SEES_THE_PLAN, ZERO_SHOT, site, seed, plan=plan, thin=preset.thins[0])
        for seed in preset.ablation_seeds:
            for ablation in preset.ablations:
                yield Scoring(SEES_THE_PLAN, ZERO_SHOT, site, seed, ablation, thin=preset.thins[0])


def _studies(preset: Preset, sites: Sequence[str]) -> Iterator[Scoring]:
    """Yield what is varied around each method at each zero-shot target."""
    for site in sites:
        for method in methods_for(ZERO_SHOT, preset):
            seed = preset.seeds[0]
            if preset.calibrations and method not in LEARNED_METHODS:
                yield Scoring(method, ZERO_SHOT, site, seed, thin=preset.thins[0], study=CALIBRATIONS)
            if preset.access_point_counts or preset.survey_errors_m:
                yield Scoring(method, ZERO_SHOT, site, seed, thin=preset.studied_thin, study=EQUIPMENT)
