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
import operator
import os
import sys

# A programmable source of ParaView puts numpy's in the place of these when it runs.
from builtins import abs, max, min, sum  # noqa: UP029

from paraview import simple

STATES = (
    ("-1", "no contact", (0.84, 0.85, 0.86)),
    ("0", "stick", (0.18, 0.43, 0.70)),
    ("1", "slip", (0.94, 0.54, 0.14)),
)
BLACK = (0.0, 0.0, 0.0)
SIZE = (1400, 900)  # pixels
TOP = 0.62  # share of the height for the joint
SHARE = 0.05  # largest displacement in the picture over the length
FRAMES = 100  # frames looked at for the largest displacement
BACK, RISE = -0.55 / math.hypot(0.55, 0.85), 0.85 / math.hypot(0.55, 0.85)  # joint to eye
ABOVE, BELOW = 50, 125  # pixels for the texts above the joint and the colours below it
LABEL, SPACE = 45, 30  # pixels above each model for its name, and between models

TIME_STEPS = """
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as pipeline
times = {times!r}
information = self.GetOutputInformation(0)
information.Set(pipeline.TIME_STEPS(), times, len(times))
information.Set(pipeline.TIME_RANGE(), [times[0], times[-1]], 2)
"""
CURVE = """
import numpy
rows = numpy.loadtxt({path!r}, delimiter=",", skiprows=1, ndmin=2)
output.RowData.append(1e3 * rows[:, 0], "time, ms")
for k, name in enumerate({names!r}, 1):
    output.RowData.append(rows[:, k] / {unit!r}, name)
"""
# A point twice: ParaView complains about lines of one.
MARK = """
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as pipeline
import numpy
rows = numpy.loadtxt({path!r}, delimiter=",", skiprows=1, ndmin=2)
step = pipeline.UPDATE_TIME_STEP()
information = self.GetOutputInformation(0)
now = information.Get(step) if information.Has(step) else 0.0
output.RowData.append(numpy.full(2, 1e3 * now), "time, ms")
for k in range(1, rows.shape[1]):
    force = numpy.interp(now, rows[:, 0], rows[:, k]) / {unit!r}
    output.RowData.append(numpy.full(2, force), "now %d" % k)
"""


def styled(shown, **properties):
    """Set properties of what is shown."""
    for name, value in properties.items():
        setattr(shown, name, value)
    return shown


def blocks_by_model(reader):
    """Paths of the bodies of each model, blocks "MODEL: BODY" or "MODEL", and of faces by name."""
    tree = reader.GetDataInformation().GetHierarchy()
    models = {}
    for node in tree.GetChildNodes(tree.GetRootNode(), False):
        name = tree.GetAttributeOrDefault(node, "label", tree.GetNodeName(node))
        model, _, part = name.partition(": ")
        bodies, faces = models.setdefault(model, ([], {}))
        if part.startswith("contact "):
            faces[part] = tree.GetNodePath(node)
        else:
            bodies.append(tree.GetNodePath(node))
    return models


def below(reader, face, low, high, reach):
    """How far to move a face towards the eye so that it lies clear of the bodies in the picture.

    Also its back corner on the left then, and how far it comes to the front; in the box that they
    move in.
    """
    extracted = simple.ExtractBlock(Input=reader, Selectors=[face])
    extracted.UpdatePipeline()
    bounds = extracted.GetDataInformation().GetBounds()
    first, last = ([bounds[2 * k + end] + sign * reach[k] for k in range(3)]
                   for end, sign in ((0, -1.0), (1, 1.0)))  # fmt: skip
    tall = (high[1] - low[1]) * RISE - (high[2] - low[2]) * BACK
    top, bottom = (at[1] * RISE - at[2] * BACK for at in (last, low))
    drop = (top - bottom + 0.15 * tall) / RISE
    front = first[1] - drop - (first[2] - low[2]) * BACK / RISE
    return drop, (first[0], last[1] - drop + 0.03 * tall / RISE, last[2]), front


def largest_displacement(reader):
    """Largest displacement, its time, and its largest parts of all frames along x, y and z."""
    times, first = list(reader.TimestepValues), operator.itemgetter(0)
    best, reach = (0.0, times[0]), [0.0, 0.0, 0.0]
    for time in times[:: max(1, len(times) // FRAMES)]:
        reader.UpdatePipeline(time)
        displacement = reader.PointData["displacement"]
        best = max(best, (displacement.GetRange(-1)[1], time), key=first)
        for k in range(3):
            reach[k] = max(reach[k], *(abs(part) for part in displacement.GetRange(k)))
    return *best, reach


def rounded(value):
    """Next lower of 1, 2, 5, 10 and so on."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(step for step in (1, 2, 5) if step * power <= value)


def can_draw(view):
    """Whether drawing works: ParaView built for X ends the process when there is no X server."""
    window = view.SMProxy.GetClientSideObject().GetRenderWindow().GetClassName()
    return window != "vtkXOpenGLRenderWindow" or bool(os.environ.get("DISPLAY"))


def show_model(reader, name, paths, view, factor, shift):
    """Warped bodies of one model in colour, their edges, and the model's name."""
    model = simple.ExtractBlock(Input=reader, Selectors=paths)
    moved = simple.Transform(Input=model)
    moved.Transform.Translate = [*shift, 0.0]
    warped = simple.WarpByVector(
        Input=moved, Vectors=["POINTS", "displacement"], ScaleFactor=factor
    )
    simple.RenameSource(f"{name}, displacement x {factor:g}", warped)
    drawn = simple.Show(warped, view)
    drawn.Representation = "Surface"
    simple.ColorBy(drawn, ("CELLS", "contact_state"))
    drawn.Ambient, drawn.Diffuse = 0.4, 0.65
    for source, colour, width in ((moved, (0.6, 0.63, 0.65), 1.0), (warped, (0.0, 0.0, 0.0), 2.0)):
        edges = simple.FeatureEdges(Input=simple.ExtractSurface(Input=source))
        line = simple.Show(edges, view)
        simple.ColorBy(line, None)
        styled(line, AmbientColor=colour, DiffuseColor=colour, LineWidth=width)


def write(view, text, place=None, corner=None, size=20):
    """Write a text at a place in space or a corner of the view."""
    shown = styled(simple.Show(simple.Text(Text=text), view), Color=BLACK, FontSize=size)
    if place is None:
        shown.WindowLocation = corner
    else:
        styled(shown, TextPropMode="Billboard 3D Text", BillboardPosition=place)


def colour_by_state(view):
    """Give stick, slip and no contact their colours, and show what they mean."""
    table = simple.GetColorTransferFunction("contact_state")
    table.InterpretValuesAsCategories = 1
    table.Annotations = [word for state in STATES for word in state[:2]]
    table.IndexedColors = [part for state in STATES for part in state[2]]
    bar = styled(simple.GetScalarBar(table, view), Title="contact", ComponentTitle="")
    styled(bar, TitleColor=BLACK, LabelColor=BLACK, TitleFontSize=18, LabelFontSize=18)
    styled(bar, WindowLocation="Any Location", Orientation="Horizontal")
    styled(bar, Position=[0.64, 0.1], ScalarBarLength=0.3, Visibility=1)


def laid_out(low, high, count, pixels):
    """Lay models out below or beside each other so that they are drawn as large as they can be.

    From the corners of the box that one model moves in, and the pixels of the view; returns the
    shift of each model along x and y, the place of its name, the middle of all along x and up the
    picture, and the length of a pixel.
    """
    label = LABEL if count > 1 else 0
    wide, bottom = high[0] - low[0], low[1] * RISE - low[2] * BACK
    top = high[1] * RISE - high[2] * BACK
    tall, options = top - bottom, []
    for columns, rows in ((1, count), (count, 1)):
        room = 0.94 * pixels[0] - (columns - 1) * SPACE
        height = pixels[1] - ABOVE - BELOW - rows * label - (rows - 1) * SPACE
        options.append((max(columns * wide / room, rows * tall / height), columns, rows))
    pixel, columns, rows = min(options)
    right = wide + SPACE * pixel if columns > 1 else 0.0
    down = tall + (SPACE + label) * pixel if rows > 1 else 0.0
    shifts = [(k * right, -k * down / RISE) for k in range(count)]
    name = (top + 0.2 * label * pixel + high[2] * BACK) / RISE
    names = [(low[0] + x, name + y, high[2]) for x, y in shifts]
    across = low[0] + 0.5 * (wide + (count - 1) * right)
    up = 0.5 * (top + label * pixel + bottom - (count - 1) * down)
    return shifts, names, (across, up + 0.5 * (ABOVE - BELOW) * pixel), pixel


def aim(view, middle, pixel, pixels):
    """Parallel view from the front and above with a point of the picture in its middle."""
    across, up = middle
    centre = [across, up * RISE, -up * BACK]
    far = 10.0 * pixel * sum(pixels)
    eye = [across, centre[1] + far * BACK, centre[2] + far * RISE]
    styled(view, CameraParallelProjection=1, CameraFocalPoint=centre, CameraPosition=eye)
    styled(view, CameraViewUp=[0.0, RISE, -BACK], CameraParallelScale=0.5 * pixels[1] * pixel)


def table(script):
    """Table that a script makes inside ParaView."""
    source = simple.ProgrammableSource(OutputDataSetType="vtkTable")
    source.Script = script
    return source


def show_load(path, times, view):
    """Curve of each load, with a mark that runs with the time."""
    path = os.path.abspath(path)
    with open(path, newline="", encoding="utf-8") as file:
        columns, *rows = csv.reader(file)
    largest = max((abs(float(word)) for row in rows for word in row[1:]), default=0.0)
    unit, short = (1e3, "kN") if largest >= 1e3 else (1.0, "N")
    names = [name.removesuffix("N") + short for name in columns[1:]]
    marks = [f"now {k}" for k in range(1, len(columns))]
    curve = table(CURVE.format(path=path, names=names, unit=unit))
    mark = table(MARK.format(path=path, unit=unit))
    mark.ScriptRequestInformation = TIME_STEPS.format(times=times)
    greys = [3 * [str(0.1 + 0.3 * k)] for k in range(len(names))]
    red, circle = len(marks) * [["0.82", "0.12", "0.12"]], {"LineStyle": "0", "MarkerStyle": "4"}
    for source, series, labels, colours, style in (
        (curve, names, names, greys, {"LineThickness": "2"}),
        (mark, marks, len(marks) * ["now"], red, circle | {"MarkerSize": "14"}),
    ):
        shown = styled(simple.Show(source, view), UseIndexForXAxis=0, XArrayName="time, ms")
        shown.SeriesVisibility = series
        shown.SeriesLabel = [word for pair in zip(series, labels, strict=True) for word in pair]
        pairs = zip(series, colours, strict=True)
        shown.SeriesColor = [word for name, colour in pairs for word in (name, *colour)]
        for key, value in style.items():
            setattr(shown, f"Series{key}", [word for name in series for word in (name, value)])

    title = names[0] if len(names) == 1 else f"force, {short}"
    styled(view, HideTimeMarker=1, BottomAxisTitle="time, ms", LeftAxisTitle="")
    styled(view, ChartTitle=title, ChartTitleAlignment="Left", ChartTitleFontSize=18)
    styled(view, ChartTitleFontFamily="Courier", ShowLegend=int(len(names) > 1))
    if largest > 0.0:
        reach = 1.15 * largest / unit
        styled(view, LeftAxisUseCustomRange=1, LeftAxisRangeMinimum=-reach)
        view.LeftAxisRangeMaximum = reach
    for axis in ("Bottom", "Left"):
        for part, size in (("Title", 18), ("Label", 16)):
            # In Arial, VTK repeats the first row and the last column of a text at its other end.
            setattr(view, f"{axis}Axis{part}FontFamily", "Courier")
            setattr(view, f"{axis}Axis{part}FontSize", size)


def joint(reader, time=None, factor=None):
    """Build the views of a series without drawing; returns the layout, its view, and the time."""
    simple._DisableFirstRenderCameraReset()
    reader.UpdatePipeline()
    times = list(reader.TimestepValues)
    largest, at, reach = largest_displacement(reader)
    if time is not None:
        at = min(times, key=lambda step: abs(step - time))
    reader.UpdatePipeline(at)
    bounds = list(reader.GetDataInformation().GetBounds())
    length = max(bounds[2 * k + 1] - bounds[2 * k] for k in range(3))
    if factor is None:
        factor = rounded(SHARE * length / largest) if largest > 0.0 else 1.0

    layout = simple.CreateLayout("joint")
    view = simple.CreateRenderView()
    simple.AssignViewToLayout(view=view, layout=layout)
    load = os.path.splitext(reader.FileName)[0] + "_load.csv"
    has_load = os.path.exists(load)
    if has_load:
        chart = simple.CreateView("XYChartView")
        layout.SplitVertical(0, TOP)
        simple.AssignViewToLayout(view=chart, layout=layout, hint=2)
    layout.SetSize(*SIZE)
    styled(view, UseColorPaletteForBackground=0, Background=[1.0, 1.0, 1.0])
    view.OrientationAxesVisibility = 0

    models = blocks_by_model(reader)
    reach = [factor * part for part in reach]
    low = [bounds[2 * k] - reach[k] for k in range(3)]
    high = [bounds[2 * k + 1] + reach[k] for k in range(3)]
    drop, label = 0.0, None
    for _, faces in list(models.values())[:1]:
        for path in list(faces.values())[:1]:
            drop, label, low[1] = below(reader, path, low, high, reach)
    pixels = (SIZE[0], SIZE[1] * (TOP if has_load else 1.0))
    shifts, places, middle, pixel = laid_out(low, high, len(models), pixels)
    for (name, parts), shift, place in zip(models.items(), shifts, places, strict=True):
        show_model(reader, name, parts[0], view, factor, shift)
        for face, path in list(parts[1].items())[:1]:
            down = shift[0], shift[1] - drop
            show_model(reader, f"{name}: {face}", [path], view, factor, down)
            write(view, face, place=(label[0] + shift[0], label[1] + shift[1], label[2]), size=18)
        if len(models) > 1:
            write(view, name, place=place, size=18)
    colour_by_state(view)
    write(view, f"displacement x {factor:g}", corner="Upper Right Corner")
    clock = simple.AnnotateTimeFilter(Input=reader, Format="t = {time:.3f} ms", Scale=1e3)
    shown = styled(simple.Show(clock, view), WindowLocation="Upper Left Corner")
    styled(shown, Color=BLACK, FontSize=20)
    aim(view, middle, pixel, pixels)
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
