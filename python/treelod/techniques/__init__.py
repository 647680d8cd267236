"""Every technique by name; a new one is one file here, one in the core, and a line below."""

from treelod.techniques.billboard import Billboard, BillboardPicture, BillboardQuad
from treelod.techniques.foliage_hierarchy import FoliageHierarchy
from treelod.techniques.full_mesh import FullMesh
from treelod.techniques.layered_billboards import LayeredBillboards
from treelod.techniques.leaf_clusters import LeafClusters
from treelod.techniques.octahedral_impostor import OctahedralImpostor
from treelod.techniques.orthogonal_slices import OrthogonalSlices
from treelod.techniques.points_and_lines import PointsAndLines
from treelod.techniques.simplified_mesh import SimplifiedMesh
from treelod.techniques.slicings import Slicings
from treelod.techniques.stochastic_pruning import StochasticPruning
from treelod.techniques.technique import BakedTexture, Footprint, Technique, TextureFormat

__all__ = [
    "REGISTRY",
    "BakedTexture",
    "Billboard",
    "BillboardPicture",
    "BillboardQuad",
    "FoliageHierarchy",
    "Footprint",
    "FullMesh",
    "LayeredBillboards",
    "LeafClusters",
    "OctahedralImpostor",
    "OrthogonalSlices",
    "PointsAndLines",
    "SimplifiedMesh",
    "Slicings",
    "StochasticPruning",
    "Technique",
    "TextureFormat",
]

REGISTRY: dict[str, type[Technique]] = {
    technique.name: technique
    for technique in (
        FullMesh,
        Slicings,
        OrthogonalSlices,
        LeafClusters,
        FoliageHierarchy,
        SimplifiedMesh,
        PointsAndLines,
        LayeredBillboards,
        StochasticPruning,
        Billboard,
        OctahedralImpostor,
    )
}
"""Techniques by the name that tables, command lines and sweeps use."""
