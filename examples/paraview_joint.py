"""The warped joint in ParaView, coloured by stick and slip, with the load's history below it.

Of solids, whose joints lie hidden between them, the first face that is pressed is shown once more.

    pvpython examples/paraview_joint.py out/fields.pvd picture.png

Options: --time SECONDS (default: where the largest displacement is), --factor NUMBER (scale of the
displacements, default: the largest is a twentieth of the length).

In ParaView itself: open fields.pvd, press Apply, then Tools > Python Shell > Run Script with this
file; the series may be played then, and the mark on the load's curve runs with it.

Needs ParaView 5.11 or newer. Without a display, use a build of ParaView for that (EGL, OSMesa), or
for one that draws through X, such as Debian's, an X server in memory: apt-get install xvfb, then
xvfb-run -a -s -noreset pvpython examples/paraview_joint.py out/fields.pvd picture.png
"""

import argparse
import csv
import math
import os
import sys

# A programmable source of ParaView puts numpy's in the place of these when it runs.
from builtins import abs, map, max, min, sum, zip  # noqa: UP029

from paraview import simple

STATES = (
    ("-1", "no contact", (0.84, 0.85, 0.86)),
    ("0", "stick", (0.18, 0.43, 0.70)),
    ("1", "slip", (0.94, 0.54, 0.14)),
)
BLACK = (0.0, 0.0, 0.0)
SIZE = (1400, 900)  # pixels
TOP = 0.62  # share of the height for the joint
BACK, RISE = -0.55 / math.hypot(0.55, 0.85), 0.85 / math.hypot(0.55, 0.85)  # joint to eye
ABOVE, BELOW, GAP = 10, 125, 55  # pixels above the joint, for the colours below, above each part

# The load's curves, and a mark that runs on each with the time: one value, the others are none.
TIME_STEPS = """
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as pipeline
times = {times!r}
information = self.GetOutputInformation(0)
information.Set(pipeline.TIME_STEPS(), times, len(times))
information.Set(pipeline.TIME_RANGE(), [times[0], times[-1]], 2)
"""
LOAD = """
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as pipeline
import numpy
rows = numpy.loadtxt({path!r}, delimiter=",", skiprows=1, ndmin=2)
step = pipeline.UPDATE_TIME_STEP()
information = self.GetOutputInformation(0)
now = information.Get(step) if information.Has(step) else 0.0
output.RowData.append(1e3 * rows[:, 0], "time, ms")
marked = numpy.arange(len(rows)) == numpy.abs(rows[:, 0] - now).argmin()
for k, name in enumerate({names!r}, 1):
    force = rows[:, k] / {unit!r}
    output.RowData.append(force, name)
    output.RowData.append(numpy.where(marked, force, numpy.nan), "now %d" % k)
"""


def blocks_by_model(reader):
    """Paths of the bodies, and names and paths of the contact faces, by the name of the model."""
    tree = reader.GetDataInformation().GetHierarchy()
    models = {}
    for node in tree.GetChildNodes(tree.GetRootNode(), False):
        name = tree.GetAttributeOrDefault(node, "label", tree.GetNodeName(node))
        model, _, part = name.partition(": ")
        bodies, faces = models.setdefault(model, ([], []))
        if part.startswith("contact "):
            faces.append((part, tree.GetNodePath(node)))
        else:
            bodies.append(tree.GetNodePath(node))
    return models


def largest_displacement(reader):
    """Largest displacement, its time, and the largest components of all frames.

    Of a long series about 100 frames are read.
    """
    times = list(reader.TimestepValues)
    best, reach = (0.0, times[0]), [0.0, 0.0, 0.0]
    for time in times[:: max(1, len(times) // 100)]:
        reader.UpdatePipeline(time)
        displacement = reader.PointData["displacement"]
        best = max(best, (displacement.GetRange(-1)[1], time), key=lambda entry: entry[0])
        for k in range(3):
            reach[k] = max(reach[k], *(abs(part) for part in displacement.GetRange(k)))
    return *best, reach


def rounded(value):
    """Largest of 1, 2, 5, 10, 20, ... that does not exceed the value."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(step for step in (1, 2, 5) if step * power <= value)


def can_draw(view):
    """Whether drawing works; ParaView built for X ends the process when there is no X server."""
    window = view.SMProxy.GetClientSideObject().GetRenderWindow().GetClassName()
    return window != "vtkXOpenGLRenderWindow" or bool(os.environ.get("DISPLAY"))


def show_part(reader, name, paths, view, factor, shift):
    """Show warped bodies or a face of a model in colour, and their edges."""
    moved = simple.Transform(Input=simple.ExtractBlock(Input=reader, Selectors=paths))
    moved.Transform.Translate = [*shift, 0.0]
    vectors = ["POINTS", "displacement"]
    warped = simple.WarpByVector(Input=moved, Vectors=vectors, ScaleFactor=factor)
    simple.RenameSource(f"{name}, displacement x {factor:g}", warped)
    drawn = simple.Show(warped, view, Representation="Surface", Ambient=0.4, Diffuse=0.65)
    simple.ColorBy(drawn, ("CELLS", "contact_state"))
    for source, colour, width in ((moved, (0.6, 0.63, 0.65), 1.0), (warped, BLACK, 2.0)):
        edges = simple.FeatureEdges(Input=simple.ExtractSurface(Input=source))
        line = simple.Show(edges, view, LineWidth=width)
        simple.ColorBy(line, None)
        line.AmbientColor = line.DiffuseColor = colour


def colour_by_state(view):
    """Give stick, slip and no contact their colours, and show what they mean."""
    table = simple.GetColorTransferFunction("contact_state")
    table.InterpretValuesAsCategories = 1
    table.Annotations = [word for state in STATES for word in state[:2]]
    table.IndexedColors = [part for state in STATES for part in state[2]]
    bar = simple.GetScalarBar(table, view)
    words = {"Title": "contact", "ComponentTitle": "", "TitleColor": BLACK, "LabelColor": BLACK}
    place = {"WindowLocation": "Any Location", "Orientation": "Horizontal", "Visibility": 1}
    place |= {"Position": [0.64, 0.1], "ScalarBarLength": 0.3}
    simple.SetProperties(bar, **words, **place, TitleFontSize=18, LabelFontSize=18)


def up(y, z):
    """Height of a point in the picture."""
    return y * RISE - z * BACK


def laid_out(columns, pixels):
    """Lay boxes out in columns, as large as they can be drawn.

    From the low and high corners of each, and the pixels of the view; returns the length of a
    pixel, the shift of each box along x and y, and the middle of all along x and up the picture.
    """
    ends = [[(up(*low[1:]), up(*high[1:])) for low, high in column] for column in columns]
    sides = [(min(low[0] for low, _ in c), max(high[0] for _, high in c)) for c in columns]
    wide = sum(right - left for left, right in sides)
    tall = max(sum(top - bottom for bottom, top in column) for column in ends)
    rows, more = max(map(len, columns)), len(columns) - 1
    space = 0.94 * pixels[0] - more * GAP, pixels[1] - ABOVE - BELOW - rows * GAP
    pixel = max(wide / space[0], tall / space[1])
    shifts, x, lowest = [], 0.0, 0.0
    for column, (left, right) in zip(ends, sides, strict=True):
        at = 0.0
        for bottom, top in column:
            at -= GAP * pixel
            shifts.append((x - left, (at - top) / RISE))
            at -= top - bottom
        x, lowest = x + right - left + GAP * pixel, min(lowest, at)
    across = 0.5 * (wide + more * GAP * pixel)
    return pixel, shifts, (across, 0.5 * (lowest + (ABOVE - BELOW) * pixel))


def aim(view, middle, pixel, pixels):
    """Set a parallel view from the front and above with a point of the picture in its middle."""
    across, height = middle
    centre = [across, height * RISE, -height * BACK]
    far = 10.0 * pixel * sum(pixels)
    view.CameraParallelProjection, view.CameraParallelScale = 1, 0.5 * pixels[1] * pixel
    view.CameraFocalPoint, view.CameraViewUp = centre, [0.0, RISE, -BACK]
    view.CameraPosition = [across, centre[1] + far * BACK, centre[2] + far * RISE]


def show_load(path, times, view):
    """Show the curve of each load, with a mark that runs with the time."""
    path = os.path.abspath(path)
    with open(path, newline="", encoding="utf-8") as file:
        columns, *rows = csv.reader(file)
    largest = max((abs(float(word)) for row in rows for word in row[1:]), default=0.0)
    unit, short = (1e3, "kN") if largest >= 1e3 else (1.0, "N")
    names = [name.removesuffix("N") + short for name in columns[1:]]
    source = simple.ProgrammableSource(OutputDataSetType="vtkTable")
    source.Script = LOAD.format(path=path, names=names, unit=unit)
    source.ScriptRequestInformation = TIME_STEPS.format(times=times)
    series = []  # name, label, colour, style of the line and of the marker
    for k, name in enumerate(names):
        series.append((name, name, 3 * [str(0.1 + 0.3 * k)], "1", "0"))
        series.append((f"now {k + 1}", "now", ["0.82", "0.12", "0.12"], "0", "4"))
    shown = simple.Show(source, view, UseIndexForXAxis=0, XArrayName="time, ms")
    shown.SeriesVisibility = [entry[0] for entry in series]
    shown.SeriesLabel = [word for entry in series for word in entry[:2]]
    shown.SeriesColor = [word for entry in series for word in (entry[0], *entry[2])]
    shown.SeriesLineStyle = [word for entry in series for word in (entry[0], entry[3])]
    shown.SeriesMarkerStyle = [word for entry in series for word in (entry[0], entry[4])]
    shown.SeriesMarkerSize = [word for entry in series for word in (entry[0], "14")]

    title = names[0] if len(names) == 1 else f"force, {short}"
    properties = {"ChartTitle": title, "ChartTitleAlignment": "Left", "ChartTitleFontSize": 18}
    properties |= {"HideTimeMarker": 1, "BottomAxisTitle": "time, ms", "LeftAxisTitle": ""}
    # In Arial, VTK repeats the first row and the last column of a text at its other end.
    texts = [f"{axis}Axis{part}" for axis in ("Bottom", "Left") for part in ("Title", "Label")]
    properties |= {f"{text}FontFamily": "Courier" for text in [*texts, "ChartTitle"]}
    properties |= {f"{text}FontSize": 18 if "Title" in text else 16 for text in texts}
    if largest > 0.0:
        reach = 1.15 * largest / unit
        properties |= {"LeftAxisUseCustomRange": 1, "LeftAxisRangeMaximum": reach}
        properties |= {"LeftAxisRangeMinimum": -reach}
    simple.SetProperties(view, ShowLegend=int(len(names) > 1), **properties)


def box(source, reach):
    """Low and high corner of the box that something moves in."""
    source.UpdatePipeline()
    bounds, low_and_high = source.GetDataInformation().GetBounds(), ((0, -1.0), (1, 1.0))
    return [[bounds[2 * k + end] + sign * reach[k] for k in range(3)] for end, sign in low_and_high]


def joint(reader, time=None, factor=None):
    """Build the views of a series without drawing; returns the layout, and the time to show."""
    simple._DisableFirstRenderCameraReset()
    reader.UpdatePipeline()
    times = list(reader.TimestepValues)
    largest, at, reach = largest_displacement(reader)
    if time is not None:
        at = min(times, key=lambda step: abs(step - time))
    reader.UpdatePipeline(at)
    if factor is None:
        ends = zip(*box(reader, 3 * [0.0]), strict=True)
        length = max(high - low for low, high in ends)
        # The largest displacement is drawn as a twentieth of the length.
        factor = rounded(0.05 * length / largest) if largest > 0.0 else 1.0

    layout, view = simple.CreateLayout("joint"), simple.CreateRenderView()
    simple.AssignViewToLayout(view=view, layout=layout)
    load = os.path.splitext(reader.FileName)[0] + "_load.csv"
    has_load = os.path.exists(load)
    if has_load:
        chart = simple.CreateView("XYChartView")
        layout.SplitVertical(0, TOP)
        simple.AssignViewToLayout(view=chart, layout=layout, hint=2)
    layout.SetSize(*SIZE)
    white = {"UseColorPaletteForBackground": 0, "Background": [1.0, 1.0, 1.0]}
    simple.SetProperties(view, OrientationAxesVisibility=0, **white)

    # Bodies of each model, and below them its first face that is pressed, if there is one.
    reach, parts = [factor * part for part in reach], []
    for name, (bodies, faces) in blocks_by_model(reader).items():
        parts.append([(name, bodies, box(reader, reach))])
        for face, path in faces[:1]:
            alone = simple.ExtractBlock(Input=reader, Selectors=[path])
            parts[-1].append((face, [path], box(alone, reach)))
    below = [part for column in parts for part in column]
    pixels = (SIZE[0], SIZE[1] * (TOP if has_load else 1.0))
    pixel, shifts, middle = min(
        laid_out([[part[-1] for part in column] for column in columns], pixels)
        for columns in (parts, [below])
    )
    for (name, paths, (low, high)), (x, y) in zip(below, shifts, strict=True):
        show_part(reader, name, paths, view, factor, (x, y))
        place = low[0] + x, high[1] + y + 0.15 * GAP * pixel / RISE, high[2]
        mode = {"TextPropMode": "Billboard 3D Text", "BillboardPosition": place}
        simple.Show(simple.Text(Text=name), view, Color=BLACK, FontSize=18, **mode)
    aim(view, middle, pixel, pixels)
    colour_by_state(view)
    clock = simple.AnnotateTimeFilter(Input=reader, Format="t = {time:.3f} ms", Scale=1e3)
    scale = simple.Text(Text=f"displacement x {factor:g}")
    for text, corner in ((clock, "Left"), (scale, "Right")):
        where = {"WindowLocation": f"Upper {corner} Corner"}
        simple.Show(text, view, Color=BLACK, FontSize=20, **where)
    if has_load:
        show_load(load, times, chart)
    return layout, view, at


def go_to(time):
    """Set the time of all views, which draws them."""
    scene = simple.GetAnimationScene()
    scene.UpdateAnimationUsingDataTimeSteps()
    scene.AnimationTime = time


def main(arguments):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("series", help="index of a series, out/fields.pvd")
    parser.add_argument("picture", nargs="?", help="PNG; SERIES.png if not given")
    parser.add_argument("--time", type=float)
    parser.add_argument("--factor", type=float)
    given = parser.parse_args(arguments)
    if not os.path.isfile(given.series):
        sys.exit(f"{given.series}: no such file")
    reader = simple.PVDReader(FileName=given.series)
    layout, view, time = joint(reader, given.time, given.factor)
    if not can_draw(view):
        sys.exit(
            "this ParaView draws through an X server and finds none: put xvfb-run -a before the "
            "command (Debian: apt-get install xvfb), or use a ParaView built for EGL or OSMesa"
        )
    go_to(time)
    picture = given.picture or os.path.splitext(given.series)[0] + ".png"
    simple.SaveScreenshot(picture, layout, ImageResolution=SIZE)
    print(picture)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(sys.argv[1:])
    elif simple.GetActiveSource() is not None:  # from ParaView's shell, with a series opened
        go_to(joint(simple.GetActiveSource())[2])
    else:
        sys.exit(__doc__)
