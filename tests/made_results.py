"""A comparison made by hand: what plots and reports are tested on, with no renderer involved."""

import math
from types import MappingProxyType, SimpleNamespace

import numpy as np

from treelod.cameras import orbit
from treelod.metrics import BackgroundErrors, Errors
from treelod.provenance import Provenance
from treelod.results import Bake, Comparison, Picture, Row, View

PLANT = SimpleNamespace(sphere=((0.0, 5.0, 0.0), 5.0))


def footprint(scale):
    """Return a footprint of round numbers."""
    return SimpleNamespace(
        triangles=1000 * scale,
        cards=30,
        lines=0,
        points=0,
        geometry_bytes=48_000 * scale,
        texture_bytes=5_000_000,
        total_bytes=48_000 * scale + 5_000_000,
    )


def errors_of(flip):
    """Return errors that grow with `flip`; none at 0."""
    psnr = math.inf if flip == 0.0 else -20.0 * math.log10(flip)
    on = {
        "black": BackgroundErrors(
            flip=flip, rmse=flip, psnr=psnr, max=flip, ssim=1.0 - flip, yee=None
        ),
        "white": BackgroundErrors(
            flip=flip / 2, rmse=flip / 2, psnr=psnr, max=flip, ssim=1.0 - flip, yee=None
        ),
    }
    return Errors(
        on=MappingProxyType(on),
        coverage_bias=-flip / 4,
        coverage_error=flip / 2,
        region=(100, 50, 300, 350),
        ppd=67.02,
    )


def comparison(labels=("full_mesh", "slicings"), distances=(2.5, 10.0), picture_size=(300, 260)):
    """
    Return a comparison of 4 azimuths, 2 elevations and `distances` at 640 x 480.

    The technique at position i takes 8 / (i + 1) ms at distance 2.5 and has errors of i * 0.02 and
    up: the first has none.
    """
    views = [
        View.of(PLANT, index, camera)
        for index, camera in enumerate(
            camera
            for distance in distances
            for elevation in (0.0, 25.0)
            for camera in orbit(PLANT, 4, elevation, distance, (640, 480))
        )
    ]
    rows = []
    for position, label in enumerate(labels):
        for view in views:
            millis = 8.0 / (position + 1) * (2.5 / view.distance) ** 0.5
            flip = position * 0.02 * (1 + 0.25 * math.sin(math.radians(2 * view.azimuth_deg + 45)))
            rows.append(
                Row(
                    label=label,
                    view=view,
                    errors=errors_of(flip),
                    error_samples=64 if position else 4,
                    # median exactly `millis`
                    frame_millis=millis * np.array([0.9, 1.0, 1.2, 0.95, 1.05]),
                    stats=SimpleNamespace(
                        triangles=1000,
                        cards=30 * position,
                        lines=0,
                        points=0,
                        vertices=3000,
                        fragments=90_000,
                        threads=2,
                    ),
                )
            )
    rng = np.random.default_rng(7)
    width, height = picture_size
    shades = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    pictures = [
        Picture(
            row=next(row for row in rows if row.label == label and row.view.index == index),
            why=why,
            background="black",
            reference=shades,
            image=shades // 2,
            difference=np.linspace(0, 1, width * height, dtype=np.float32).reshape(height, width),
        )
        for label in labels
        for why, index in (("near", 0), ("far", len(views) - 1), ("worst", 1))
    ]
    return Comparison(
        plant={
            "name": "oak",
            "summary": "oak: 2000 triangles",
            "triangle_count": 2000,
            "wood_triangle_count": 500,
            "foliage_triangle_count": 1500,
            "leaf_count": 150,
            "leaf_area": 12.5,
            "material_count": 2,
            "extent": (6.0, 10.0, 6.5),
            "radius": 5.0,
        },
        portrait=shades,
        split_portrait=shades,
        reference_label=labels[0],
        bakes=[
            Bake(
                label=label,
                technique=label.partition(":")[0],
                params={"slice_count": 5, "correction": "fit"} if position else {},
                build_secs=0.25 * (position + 1),
                footprint=footprint(position + 1),
            )
            for position, label in enumerate(labels)
        ],
        views=views,
        rows=rows,
        pictures=pictures,
        settings={
            "time_samples": 4,
            "reference_samples": 64,
            "repeats": 5,
            "warmup": 2,
            "threads": 2,
            "ppd": 67.02,
            "backend": "cpu",
            "adapter": None,
            "driver": None,
        },
        source={"file": "oak.glb", "sha256": "00ff" * 16},
        provenance=Provenance(
            treelod="1.2.3",
            git_commit=None,
            build_profile="release",
            packages={"numpy": "2.4.6"},
            python="3.11.7",
            platform="Linux",
            cpu="A Processor",
            core_count=2,
            date="2026-01-02T03:04:05+00:00",
        ),
    )
