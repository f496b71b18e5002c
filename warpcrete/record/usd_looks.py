"""Materials, light and documentation of a USD scene."""

# pyright: reportAttributeAccessIssue=false
# Modules of pxr (the USD library) add attributes when they are imported, so Pyright must not report them as missing.

from typing import Any

import numpy as np

from ..core.drawing.display import Display, DrawnWall
from ..core.drawing.paint import Paint
from .legend import meaning, paint_meaning

LOOKS = "/Run/Looks"
CLEAR, PAINT = 0.14, 0.6
"""Minimum opacity of walls that are drawn as glass, and opacity of walls whose colours show a quantity such as wear."""
SUN, SKY = 0.6, 0.5
"""Intensities of the sun and of the sky light, in USD's units of light. The intensity of the sun does not depend on the
size of its disc, and the sky shines from all sides."""
SUN_ANGLE = 4.0
"""Angular size of the sun's disc [degrees], which softens the edges of shadows."""


def linear(colours: np.ndarray) -> np.ndarray:
    """Return sRGB bytes as the linear colours from 0 to 1 that USD requires (IEC 61966-2-1)."""
    c = np.asarray(colours, float) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).astype(np.float32)


def describe(stage: Any, display: Display, scene: Any) -> None:
    """Write the title, the units and the meaning of the colours into the file and into its root prim."""
    words = (
        f"warpcrete: {scene.caption}; {display.noun} coloured by {display.colouring}. Metres, Z up; time codes are "
        f"milliseconds of simulated time. {meaning(display)}"
    ).strip()
    layer = stage.GetRootLayer()
    layer.documentation = words
    layer.customLayerData = {"title": f"warpcrete: {scene.caption}", "scene": scene.name, "colours": meaning(display)}
    stage.GetDefaultPrim().SetDocumentation(words)


def light(stage: Any, display: Display) -> None:
    """Add a sky light, and a sun that shines from a direction above and beside the camera."""
    from pxr import Gf, UsdGeom, UsdLux

    UsdGeom.Scope.Define(stage, "/Run/Lights")
    sky = UsdLux.DomeLight.Define(stage, "/Run/Lights/Sky")
    sky.CreateIntensityAttr(SKY)
    sun = UsdLux.DistantLight.Define(stage, "/Run/Lights/Sun")
    sun.CreateIntensityAttr(SUN)
    sun.CreateAngleAttr(SUN_ANGLE)
    sun.CreateNormalizeAttr(True)
    eye, target = display.view(1.0)
    toward = eye - target
    side = np.cross([0.0, 0.0, 1.0], toward)
    place = toward - 0.6 * side + [0.0, 0.0, float(np.linalg.norm(toward))]
    turned = Gf.Matrix4d().SetLookAt(Gf.Vec3d(*map(float, place)), Gf.Vec3d(0, 0, 0), Gf.Vec3d(0, 0, 1)).GetInverse()
    turned.SetTranslateOnly(Gf.Vec3d(0, 0, 0))
    sun.ClearXformOpOrder()
    sun.AddTransformOp().Set(turned)


def bodies_look(stage: Any) -> Any:
    """Return a material for bodies, whose colour comes from the USD attribute `displayColor`."""
    from pxr import Sdf

    material, surface = _material(stage, "Bodies")
    _by_display_colour(stage, surface, "Bodies")
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.6)
    return material


def _by_display_colour(stage: Any, surface: Any, name: str) -> None:
    from pxr import Gf, Sdf, UsdShade

    reader = UsdShade.Shader.Define(stage, f"{LOOKS}/{name}/Colour")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    reader.CreateInput("fallback", Sdf.ValueTypeNames.Float3).Set(Gf.Vec3f(0.5, 0.5, 0.5))
    reader.CreateOutput("result", Sdf.ValueTypeNames.Float3)
    colour = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    colour.ConnectToSource(reader.ConnectableAPI(), "result")


def wall_look(stage: Any, wall: DrawnWall, name: str, painted: bool = False) -> tuple[Any, Any, float]:
    """Return the USD material, the linear RGB colour and the opacity with which a wall is drawn.

    Transparent walls look like glass, and opaque moving walls look like metal. If the wall is `painted`, its material
    takes the colours from the attribute `displayColor` of the wall's mesh.
    """
    from pxr import Gf, Sdf

    opacity = max(CLEAR, wall.colour[3] / 255)
    opacity = PAINT if painted else opacity
    colour = Gf.Vec3f(*map(float, linear(np.array(wall.colour[:3]))))
    material, surface = _material(stage, name)
    if painted:
        _by_display_colour(stage, surface, name)
    else:
        surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(colour)
    surface.CreateInput("opacity", Sdf.ValueTypeNames.Float).Set(opacity)
    metal = wall.moves and wall.colour[3] == 255
    surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.8 if metal else 0.0)
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.35 if opacity == 1.0 else 0.1)
    return material, colour, opacity


def bind(prim: Any, material: Any) -> None:
    """Assign a material to a USD prim (object of the USD scene) and to all prims below it."""
    from pxr import UsdShade

    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)


def _material(stage: Any, name: str) -> tuple[Any, Any]:
    from pxr import Sdf, UsdGeom, UsdShade

    UsdGeom.Scope.Define(stage, LOOKS)
    material = UsdShade.Material.Define(stage, f"{LOOKS}/{name}")
    surface = UsdShade.Shader.Define(stage, f"{LOOKS}/{name}/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    return material, surface


class Colours:
    """Colours of bodies over time, as indices into a table of all colours.

    The indices take one or two bytes each in the file.
    """

    def __init__(self, primvar: Any) -> None:
        self._primvar = primvar
        known = primvar.Get()  # If an existing USD file is continued, start with the table of colours in that file.
        self._table = np.zeros((0, 3), np.float32) if known is None else np.array(known, np.float32)
        self._numbers: dict[bytes, int] = {row.tobytes(): number for number, row in enumerate(self._table)}
        # Index of each colour in the table of colours, for all colours used so far. The keys are the colours as packed
        # RGB bytes.
        self._known: dict[int, int] = {}

    def set(self, colours: np.ndarray, code: Any) -> None:
        """Set the colours of all bodies, as RGB bytes of shape (n, 3), at the USD time code `code` [ms]."""
        from pxr import Vt

        packed = colours.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
        distinct, place = np.unique(packed, return_inverse=True)
        new = []
        for number in distinct.tolist():
            if number not in self._known:
                row = linear(np.array([[number >> 16, number >> 8 & 255, number & 255]]))[0]
                if row.tobytes() not in self._numbers:
                    self._numbers[row.tobytes()] = len(self._numbers)
                    new.append(row)
                self._known[number] = self._numbers[row.tobytes()]
        if new:
            self._table = np.concatenate([self._table, new])
            self._primvar.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(self._table, np.float32)))
        numbers = np.array([self._known[number] for number in distinct.tolist()], np.int32)
        self._primvar.SetIndices(Vt.IntArray.FromNumpy(numbers[place.ravel()]), code)


class Painted:
    """Colours over time of a wall that shows a quantity such as wear, as indices into a table of colours.

    All frames use the same table. Each of its entries is the colour of one of the discrete values to which
    :class:`.Paint` rounds.
    """

    def __init__(self, mesh: Any) -> None:
        from pxr import UsdGeom

        self._prim = mesh.GetPrim()
        self._primvar = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
        self._paint: Paint | None = None

    def set(self, values: np.ndarray, paint: Paint, code: Any) -> None:
        """Set the colours of the wall at the USD time code `code` [ms].

        `values` are the values of the quantity at the wall's vertices, shape (v,), in the unit of `paint`.
        """
        from pxr import Vt

        if paint != self._paint:
            self._paint = paint
            self._primvar.Set(Vt.Vec3fArray.FromNumpy(linear(paint.colours())))
            self._prim.SetDocumentation(paint_meaning(paint))
            scale = {"quantity": paint.label, "lower": 0.0, "upper": float(paint.upper), "palette": paint.palette}
            self._prim.SetCustomDataByKey("colours", scale)
        self._primvar.SetIndices(Vt.IntArray.FromNumpy(paint.steps(values)), code)
