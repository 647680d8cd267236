"""All checks of one plant, in order, with what is needed to repeat them."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from treelod.provenance import provenance
from treelod.references import mitsuba
from treelod.references.checks import words_for
from treelod.references.clusters import ClusterSettings
from treelod.references.color import color_section, lambert_section
from treelod.references.coverage import SliceSettings, slices_section, view_section
from treelod.references.geometry import geometry_section
from treelod.references.impostors import clusters_section
from treelod.references.runner import VERSIONED, require
from treelod.references.soup import plant_soup
from treelod.references.visibility import visibility_section

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from treelod.plants import Plant
    from treelod.references.checks import Check, Section

__all__ = ["FULL", "QUICK", "Extent", "Validation", "validate"]


class Extent(NamedTuple):
    """
    How large the pictures of a validation are, and of how many samples.

    Attributes
    ----------
    rays : tuple of 2 ints
        Pixels of the views compared with rays.
    view : tuple of 2 ints
        Pixels of the views compared with mitsuba.
    color_spp, alpha_spp : int
        Samples a pixel of mitsuba in those of lit colour and of coverage.
    slices : SliceSettings
        Textures compared with mitsuba.
    clusters : ClusterSettings
        Cards of leaf clusters.
    """

    rays: tuple[int, int]
    view: tuple[int, int]
    color_spp: int
    alpha_spp: int
    slices: SliceSettings
    clusters: ClusterSettings


QUICK = Extent(
    rays=(1024, 768),
    view=(64, 64),
    color_spp=256,
    alpha_spp=256,
    slices=SliceSettings(side=64, precise_count=1, precise_spp=256, slicing_count=1, spp=64),
    clusters=ClusterSettings(
        side=128,
        cluster_count=8,
        card_count=2,
        turned_count=1,
        precise_count=1,
        precise_spp=256,
        spp=64,
        rays=(256, 192),
    ),
)
"""Half a minute to two a plant."""

FULL = Extent(
    rays=(1024, 768),
    view=(1024, 768),
    color_spp=256,
    # 50 million samples: the noise of their mean is a hundredth of what is allowed
    alpha_spp=64,
    slices=SliceSettings(side=256, precise_count=5, precise_spp=256, slicing_count=6, spp=64),
    clusters=ClusterSettings(
        side=256,
        cluster_count=32,
        card_count=32,
        turned_count=2,
        precise_count=2,
        precise_spp=256,
        spp=64,
        rays=(1024, 768),
    ),
)
"""Everything at the size it is drawn at; minutes to a quarter of an hour a plant."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Validation:
    """
    What was found for a plant.

    Attributes
    ----------
    plant : str
        Its name.
    summary : str
        Its `Plant.summary`.
    sections : list of Section
        Checks and pictures.
    left_out : list of str
        What could not be checked on this plant, and why.
    full : bool
        Whether at full size.
    secs : float
        Seconds that it took, cached references not counted.
    source : dict
        Where the plant came from.
    made : dict
        Versions and machine.
    """

    plant: str
    summary: str
    sections: list[Section]
    left_out: list[str]
    full: bool
    secs: float
    source: dict[str, Any]
    made: dict[str, Any]

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return all(section.passed for section in self.sections)

    def figures(self) -> dict[str, Any]:
        """
        Return everything but the pictures, for JSON.

        Returns
        -------
        dict
            Figures that are not finite are None, and ``value_is`` or ``limit_is`` says what they
            are.
        """
        return {
            "plant": self.plant,
            "passed": self.passed,
            "full": self.full,
            "secs": self.secs,
            "source": self.source,
            "left_out": self.left_out,
            "made": self.made,
            "checks": [
                {
                    "section": section.title,
                    **_facts(check),
                    "passed": check.passed,
                }
                for section in self.sections
                for check in section.checks
            ],
        }


def _facts(check: Check) -> dict[str, Any]:
    facts = dataclasses.asdict(check)
    for name in ("value", "limit"):
        words = words_for(facts[name])
        if words:
            # JSON has no word for them
            facts |= {name: None, f"{name}_is": words}
    return facts


def _made() -> dict[str, Any]:
    """Say what was at work, the references' versions first."""
    made = dataclasses.asdict(provenance())
    references = {name: importlib.metadata.version(name) for name in VERSIONED}
    return {**made, "packages": {**references, **made["packages"]}}


def validate(
    plant: Plant,
    *,
    full: bool = False,
    extent: Extent | None = None,
    source: Mapping[str, Any] | None = None,
    progress: Callable[[str, int, int], object] | None = None,
) -> Validation:
    """
    Compare everything that is drawn and baked of a plant with mitsuba, embree and trimesh.

    Parameters
    ----------
    plant : Plant
        Any.
    full : bool, default False
        At full size: minutes instead of seconds.
    extent : Extent, optional
        Sizes instead of those that `full` means.
    source : mapping, optional
        Where the plant came from, for the record.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.

    Returns
    -------
    Validation

    Raises
    ------
    ImportError
        If the extra ``validate`` is not installed.
    ReferenceFailedError
        If a reference's process fails twice.
    """
    require()
    extent = extent or (FULL if full else QUICK)
    report = progress or (lambda stage, done, total: None)

    def stage(name: str) -> Callable[[int, int], None]:
        def told(done: int, total: int) -> None:
            report(name, done, total)

        return told

    start = time.perf_counter()
    sections = [lambert_section(stage("light"))]
    report("geometry", 0, 1)
    sections.append(geometry_section(plant))
    report("geometry", 1, 1)
    left_out = []
    sized = plant.sphere[1] > 0.0
    if sized:
        sections.append(visibility_section(plant, extent.rays, stage("rays")))
        sections.append(color_section(plant, extent.view, extent.color_spp, stage("lit colour")))
    if not sized:
        left_out.append("pictures: the plant is a point")
    elif mitsuba.can_be_masked(plant_soup(plant)):
        sections.append(view_section(plant, extent.view, extent.alpha_spp, stage("coverage")))
        if plant.foliage.leaf_count:
            sections.append(slices_section(plant, extent.slices, stage("slices")))
            sections.append(clusters_section(plant, extent.clusters, stage("leaf clusters")))
        else:
            left_out.append("slices and leaf clusters: the plant has no leaves")
    else:
        left_out.append(
            "coverage: mitsuba takes one opacity and one kind of wrap a material, "
            "this plant has a material with two"
        )
    return Validation(
        plant=plant.name,
        summary=plant.summary(),
        sections=sections,
        left_out=left_out,
        full=full,
        secs=time.perf_counter() - start,
        source=dict(source or {}),
        made=_made(),
    )
