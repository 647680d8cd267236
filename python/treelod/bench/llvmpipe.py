"""
How fast does Mesa's llvmpipe draw the same triangles? The peer of the raster benchmark.

It runs in a process of its own, because its number of threads is fixed when its first device is
made. The process draws one frame for each line it is sent and answers with the seconds from
submission to idle: clear, draw and resolve; no upload and no read-back.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from types import TracebackType

    from numpy.typing import NDArray

__all__ = ["MAX_SAMPLES", "Llvmpipe"]

MAX_SAMPLES = 4
"""llvmpipe renders to float pictures at 1 and at 4 samples."""

_SHADER = """
struct Camera { clip_from_local: mat4x4<f32> };
@group(0) @binding(0) var<uniform> camera: Camera;
struct Vertex {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(perspective, centroid) front: vec3<f32>,
    @location(1) @interpolate(perspective, centroid) back: vec3<f32>,
};
@vertex fn place(
    @location(0) position: vec3<f32>, @location(1) front: vec3<f32>, @location(2) back: vec3<f32>
) -> Vertex {
    return Vertex(camera.clip_from_local * vec4<f32>(position, 1.0), front, back);
}
@fragment fn color(vertex: Vertex, @builtin(front_facing) front: bool) -> @location(0) vec4<f32> {
    return vec4<f32>(select(vertex.back, vertex.front, front), 1.0);
}
"""

_ANSWER_SECS = 120.0
"""A process that has not answered by then hangs; frames take under a second."""


class Llvmpipe:
    """
    A process that draws one list of triangles with llvmpipe.

    Parameters
    ----------
    positions, front, back : ndarray of shape (V, 3), dtype float32
        Vertices, and their colours seen from either side.
    triangles : ndarray of shape (T, 3), dtype uint32
        Indices of vertices.
    clip_from_local : ndarray of shape (4, 4), dtype float64
        Projection with depth in [0, 1]; larger is nearer.
    size : tuple of 2 ints
        Width and height in pixels.
    samples : int
        1 or 4.
    threads : int
        Threads that rasterise; with 1 the thread that submits does it.

    Raises
    ------
    ImportError
        If the PyPI package ``wgpu`` is missing.
    RuntimeError
        If there is no llvmpipe (Debian: ``mesa-vulkan-drivers``), or it fails.
    """

    def __init__(
        self,
        *,
        positions: NDArray[np.float32],
        front: NDArray[np.float32],
        back: NDArray[np.float32],
        triangles: NDArray[np.uint32],
        clip_from_local: NDArray[np.float64],
        size: tuple[int, int],
        samples: int,
        threads: int,
    ) -> None:
        try:
            import wgpu  # noqa: F401
        except ImportError as missing:
            msg = "the raster benchmark needs wgpu: pip install 'treelod[bench]'"
            raise ImportError(msg) from missing
        self._folder = tempfile.TemporaryDirectory(prefix="treelod-llvmpipe-")
        scene = Path(self._folder.name) / "scene.npz"
        vertices = np.concatenate([positions, front, back], axis=1, dtype=np.float32)
        np.savez(
            scene,
            vertices=vertices,
            triangles=np.ascontiguousarray(triangles, dtype=np.uint32),
            clip_from_local=clip_from_local.astype(np.float32),
            size=np.array(size),
            samples=np.array(samples),
        )
        environment = {**os.environ, "LP_NUM_THREADS": str(threads if threads > 1 else 0)}
        # a file: a pipe that nobody empties can stop the process
        self._errors = (Path(self._folder.name) / "errors.txt").open("w+")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "treelod.bench.llvmpipe", str(scene)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            stderr=self._errors,
            env=environment,
        )
        self.adapter = self._answer()

    def __enter__(self) -> Llvmpipe:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.stdin and self._process.stdin.close()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout and self._process.stdout.close()
        self._errors.close()
        self._folder.cleanup()

    def draw(self) -> float:
        """Draw a frame and return the seconds it took."""
        return float(self._ask("draw"))

    def picture(self) -> NDArray[np.float32]:
        """Return what it draws: linear colour and coverage, shape (H, W, 4)."""
        picture: NDArray[np.float32] = np.load(self._ask("picture"))
        return picture

    def _ask(self, what: str) -> str:
        assert self._process.stdin is not None
        self._process.stdin.write(what + "\n")
        self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> str:
        assert self._process.stdout is not None
        limit = threading.Timer(_ANSWER_SECS, self._process.kill)
        limit.start()
        try:
            line = self._process.stdout.readline()
        finally:
            limit.cancel()
        if not line:
            status = self._process.wait()
            self._errors.seek(0)
            words = self._errors.read().strip().splitlines()[-1:]
            msg = f"llvmpipe ended with status {status}: {' '.join(words)}"
            raise RuntimeError(msg)
        return line.strip()


def _device() -> tuple[Any, str]:
    import wgpu

    for adapter in wgpu.gpu.enumerate_adapters_sync():
        if adapter.info["backend_type"] == "Vulkan" and "llvmpipe" in adapter.info["device"]:
            # four samples of floats are beyond what WebGPU promises
            device = adapter.request_device_sync(
                required_features=["texture-adapter-specific-format-features"]
            )
            return device, f"llvmpipe ({adapter.info['description']})"
    msg = "no Vulkan adapter is llvmpipe (Debian has it in mesa-vulkan-drivers)"
    raise RuntimeError(msg)


def _serve(scene: str, source: IO[str], target: IO[str]) -> None:
    import wgpu

    facts = np.load(scene)
    device, name = _device()
    samples = int(facts["samples"])
    width, height = (int(side) for side in facts["size"])
    usage = wgpu.BufferUsage
    vertices = device.create_buffer_with_data(
        data=np.ascontiguousarray(facts["vertices"]), usage=usage.VERTEX
    )
    indices = device.create_buffer_with_data(
        data=np.ascontiguousarray(facts["triangles"]), usage=usage.INDEX
    )
    # WGSL's matrices are stored by column
    camera = device.create_buffer_with_data(
        data=np.ascontiguousarray(facts["clip_from_local"].T), usage=usage.UNIFORM | usage.COPY_SRC
    )
    module = device.create_shader_module(code=_SHADER)
    pipeline = device.create_render_pipeline(
        layout="auto",
        vertex={
            "module": module,
            "entry_point": "place",
            "buffers": [
                {
                    "array_stride": 36,
                    "step_mode": "vertex",
                    "attributes": [
                        {"format": "float32x3", "offset": 12 * slot, "shader_location": slot}
                        for slot in range(3)
                    ],
                }
            ],
        },
        primitive={"topology": "triangle-list", "front_face": "ccw", "cull_mode": "none"},
        depth_stencil={
            "format": "depth32float",
            "depth_write_enabled": True,
            "depth_compare": "greater",
        },
        multisample={"count": samples},
        fragment={
            "module": module,
            "entry_point": "color",
            "targets": [{"format": "rgba32float"}],
        },
    )
    group = device.create_bind_group(
        layout=pipeline.get_bind_group_layout(0),
        entries=[{"binding": 0, "resource": {"buffer": camera, "offset": 0, "size": 64}}],
    )

    def texture(kind: str, count: int, usage: int) -> Any:
        return device.create_texture(
            size=(width, height, 1), format=kind, sample_count=count, usage=usage
        )

    attach = wgpu.TextureUsage.RENDER_ATTACHMENT
    shown = texture("rgba32float", 1, attach | wgpu.TextureUsage.COPY_SRC)
    many = texture("rgba32float", samples, attach) if samples > 1 else None
    depth = texture("depth32float", samples, attach)

    def draw() -> float:
        encoder = device.create_command_encoder()
        color: dict[str, Any] = {
            "view": (many or shown).create_view(),
            "clear_value": (0.0, 0.0, 0.0, 0.0),
            "load_op": "clear",
            "store_op": "store",
        }
        if many is not None:
            color |= {"resolve_target": shown.create_view(), "store_op": "discard"}
        render = encoder.begin_render_pass(
            color_attachments=[color],
            depth_stencil_attachment={
                "view": depth.create_view(),
                "depth_clear_value": 0.0,
                "depth_load_op": "clear",
                "depth_store_op": "discard",
            },
        )
        render.set_pipeline(pipeline)
        render.set_bind_group(0, group)
        render.set_vertex_buffer(0, vertices)
        render.set_index_buffer(indices, "uint32")
        render.draw_indexed(facts["triangles"].size)
        render.end()
        commands = encoder.finish()
        start = time.perf_counter()
        device.queue.submit([commands])
        # work is done in order, so a few bytes that come back say that the frame is finished;
        # wgpu 0.32 cannot be asked for it directly
        device.queue.read_buffer(camera)
        return time.perf_counter() - start

    def picture() -> Path:
        draw()
        row_bytes = width * 16
        data = device.queue.read_texture(
            {"texture": shown},
            {"bytes_per_row": row_bytes, "rows_per_image": height},
            (width, height, 1),
        )
        pixels = np.frombuffer(data, np.float32).reshape(height, width, 4)
        path = Path(scene).with_name("picture.npy")
        np.save(path, pixels)
        return path

    print(name, file=target, flush=True)
    for line in source:
        answer: Any = draw() if line.strip() == "draw" else picture()
        print(answer, file=target, flush=True)


if __name__ == "__main__":
    _serve(sys.argv[1], sys.stdin, sys.stdout)
