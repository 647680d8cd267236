"""Points and lines drawn by VTK off-screen, with OpenGL on the processor: a benchmark's peer."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from types import TracebackType

    from numpy.typing import NDArray

    from treelod.bench.subjects import Cloud
    from treelod.cameras import Camera

__all__ = ["VtkCloud"]


class VtkCloud:
    """
    A window of VTK, off-screen, that shows points or lines in flat colours.

    Parameters
    ----------
    cloud : Cloud
        What it shows.
    camera : Camera
        A perspective camera.
    samples : int
        Samples a pixel; VTK's window has multisampling.

    Raises
    ------
    ImportError
        If VTK is not installed: ``pip install "treelod[bench]"``.
    RuntimeError
        If VTK finds no OpenGL that draws on the processor: its times would say nothing about it.
    """

    def __init__(self, cloud: Cloud, *, camera: Camera, samples: int = 1) -> None:
        try:
            import vtk
            from vtk.util import numpy_support
        except ImportError as error:
            msg = 'VTK is not installed: pip install "treelod[bench]"'
            raise ImportError(msg) from error
        # it first looks for an X server and warns that there is none
        vtk.vtkLogger.SetStderrVerbosity(vtk.vtkLogger.VERBOSITY_OFF)
        colors = (np.clip(cloud.colors, 0, 1) * 255 + 0.5).astype(np.uint8)
        self._kept = [cloud.positions, colors]
        points = vtk.vtkPoints()
        points.SetData(numpy_support.numpy_to_vtk(self._kept[0]))
        cells = vtk.vtkCellArray()
        ids = np.arange(len(cloud.positions), dtype=np.int64)
        self._kept.append(ids)
        cells.SetData(2 if cloud.lines else 1, numpy_support.numpy_to_vtkIdTypeArray(ids))
        data = vtk.vtkPolyData()
        data.SetPoints(points)
        (data.SetLines if cloud.lines else data.SetVerts)(cells)
        data.GetPointData().SetScalars(numpy_support.numpy_to_vtk(self._kept[1]))
        mapper = vtk.vtkPolyDataMapper()
        mapper.SetInputData(data)
        actor = vtk.vtkActor()
        actor.SetMapper(mapper)
        look = actor.GetProperty()
        look.LightingOff()
        look.SetPointSize(cloud.size_px)
        look.SetLineWidth(cloud.size_px)
        self._renderer = vtk.vtkRenderer()
        self._renderer.AddActor(actor)
        self._window = vtk.vtkRenderWindow()
        self._window.SetOffScreenRendering(1)
        self._window.SetMultiSamples(0 if samples == 1 else samples)
        self._window.AddRenderer(self._renderer)
        self._window.SetSize(*camera.size)
        view = self._renderer.GetActiveCamera()
        view.SetPosition(*camera.eye)
        view.SetFocalPoint(*camera.target)
        view.SetViewUp(*camera.up)
        assert camera.fov_y_deg is not None
        view.SetViewAngle(camera.fov_y_deg)
        self._renderer.ResetCameraClippingRange()
        self._window.Render()
        facts = self._window.ReportCapabilities().splitlines()
        found = [line.split(":", 1)[1].strip() for line in facts if "OpenGL renderer" in line]
        self.adapter = found[0] if found else "unknown"
        if "llvmpipe" not in self.adapter and "softpipe" not in self.adapter:
            msg = f"VTK draws with {self.adapter}, not on the processor"
            raise RuntimeError(msg)
        self.version: str = vtk.vtkVersion.GetVTKVersion()
        self._numpy_support: Any = numpy_support
        self._vtk: Any = vtk

    def __enter__(self) -> VtkCloud:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._window.Finalize()

    def draw(self) -> float:
        """Draw a frame whose data are on the renderer's side already, and return its seconds."""
        self._renderer.GetActiveCamera().Modified()
        start = time.perf_counter()
        self._window.Render()
        self._window.WaitForCompletion()
        return time.perf_counter() - start

    def picture(self) -> NDArray[np.uint8]:
        """Return the last frame: shape (H, W, 3), row 0 on top."""
        reader = self._vtk.vtkWindowToImageFilter()
        reader.SetInput(self._window)
        reader.Update()
        image = reader.GetOutput()
        width, height, _ = image.GetDimensions()
        flat = self._numpy_support.vtk_to_numpy(image.GetPointData().GetScalars())
        return np.ascontiguousarray(flat.reshape(height, width, 3)[::-1])
