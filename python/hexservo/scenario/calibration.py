"""Calibrations of OpenCV as camera blocks of a scenario."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from hexservo.scenario.arrays import Array, real_numbers
from hexservo.scenario.plain import plain
from hexservo.scenario.reading import path_text
from hexservo.scenario.rules import shown_value
from hexservo.scenario.yaml import ScenarioError, load_yaml, read_text

_BROWN_CONRADY, _KANNALA_BRANDT = 5, 4  # numbers of coefficients
_Model: TypeAlias = Literal["brown_conrady", "kannala_brandt"]

# Keys of calibration files: of OpenCV's FileStorage and its tutorials, of ROS 1 and ROS 2.
_MATRICES = ("camera_matrix", "cameraMatrix", "K", "k", "mtx")
_COEFFICIENTS = (
    *("distortion_coefficients", "distortion_coeffs", "distCoeffs", "dist_coeffs", "dist_coeff"),
    *("distortion", "dist", "D", "d"),
)
_WIDTHS = ("image_width", "image_Width", "width")
_HEIGHTS = ("image_height", "image_Height", "height")
_OF_SIZE = re.compile(  # other names of the size, without underscores: some have the height first
    r"^(im|img|image|frame)?(size|shape|resolution|dims?|dimensions?)$|^(im|img|image|frame)(width|height|w|h)$"
)
_OF_MODEL = re.compile(r"model|type")  # keys whose value may be the model of the lens
_LENS_MODELS = ("distortion_model", "lens_model")  # keys whose value is
_FISHEYE = "fisheye_model"  # 0 or 1
_NO_MODEL = ("", "pinhole")  # ROS has none where it is not known; every one of the models distorts a pinhole
_COEFFICIENT = re.compile(r"^[dkp]_?\d+$|^xi$")  # one number
_OF_LENS = re.compile(r"^dist|distort|coef|lens|radial|tangential|intrinsic")  # several
_OF_MATRIX = {re.sub("_", "", name.lower()) for name in _MATRICES}
_OF_OTHER_IMAGE = re.compile(r"(new|optimal)_?(camera)?_?(mtx|matrix)")  # of cv2.getOptimalNewCameraMatrix
_DEVIATIONS = re.compile(r"std_?dev|error")
_MODELS: dict[str, _Model] = {  # names of the two, in lower case with underscores
    **dict.fromkeys(("plumb_bob", "radtan", "brown", "brown_conrady"), "brown_conrady"),
    "rational_polynomial": "brown_conrady",  # where k4, k5 and k6 are zero, which the number of coefficients checks
    **dict.fromkeys(("fisheye", "equidistant", "kannala_brandt"), "kannala_brandt"),
}
_OTHER_MODELS = (
    "omni",
    "omnidir",
    "mei",
    "ucm",
    "eucm",
    "ds",
    "double_sphere",
    "fov",
    "ftheta",
    "thin_prism",
    "division",
)


def camera_from_opencv(
    K: ArrayLike,  # noqa: N803 (as in OpenCV)
    distortion: ArrayLike | None = None,
    size: Sequence[int] | None = None,
    *,
    model: _Model = "brown_conrady",
) -> dict[str, Any]:
    """Return keys of a scenario's camera for a calibration of OpenCV, as it is.

    ``scenario.updated({"camera": camera_from_opencv(K, distortion, size)})`` has pixels that count as OpenCV's do: from
    the centre of the first pixel, to the right and down. Mount and timing stay.

    Parameters
    ----------
    K
        (3, 3) camera matrix [px], without skew.
    distortion
        Coefficients [1] in OpenCV's order: of ``cv2.calibrateCamera`` k1, k2, p1, p2 and k3 (4 or 5 of them; more only
        if they are zero), of ``cv2.fisheye.calibrate`` k1 to k4; None: no distortion. Without any, ``[]``, there is
        none either, but of a fisheye lens, whose image is none of a pinhole with zeros.
    size
        (width, height) [px]: the border of the image, for scenarios in sampled mode; None: no border.
    model
        Which of the two functions made the calibration.

    Raises
    ------
    ValueError
        "K: expected ..., got ...": a matrix with another shape, with skew or without two positive focal lengths;
        coefficients of another model; a size that is no two positive numbers.
    """
    matrix = _numbers("K", K, (3, 3))
    if not (matrix[0, 0] > 0.0 and matrix[1, 1] > 0.0):
        raise ValueError(f"K: expected focal lengths > 0, got {matrix[0, 0]:g} and {matrix[1, 1]:g}")
    rest = matrix - [[matrix[0, 0], 0.0, matrix[0, 2]], [0.0, matrix[1, 1], matrix[1, 2]], [0.0, 0.0, 1.0]]
    if np.any(rest):
        raise ValueError(f"K: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {shown_value(matrix.tolist())}")
    camera: dict[str, Any] = {
        "focal_length": None,
        "pixel_scale": None,
        "focal_pixels": [float(matrix[0, 0]), float(matrix[1, 1])],
        "principal_point": [float(matrix[0, 2]), float(matrix[1, 2])],
        "distortion": {"brown_conrady": None, "kannala_brandt": None},
        "image_size": None,
    }
    if model not in camera["distortion"]:
        raise ValueError(f'model: expected "brown_conrady" or "kannala_brandt", got {shown_value(model)}')
    if distortion is not None:
        camera["distortion"][model] = _coefficients(distortion, model) or None
    if size is not None:
        width, height = _numbers("size", size, (2,)).tolist()
        if not (width > 0.0 and height > 0.0):
            raise ValueError(f"size: expected (width, height) > 0, got ({width:g}, {height:g})")
        camera["image_size"] = [width, height]
    return camera


def camera_from_file(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return keys of a scenario's camera for a calibration file: YAML or JSON of OpenCV's ``FileStorage``, or of ROS.

    A last line ``---``, as of a message that ``ros2 topic echo`` prints, does not count. The camera matrix is
    ``camera_matrix``, ``cameraMatrix``, ``K``, ``k`` or ``mtx``, also as nine numbers in a row; the coefficients are
    ``distortion_coefficients``, ``dist_coeffs``, ``D`` or another of their usual names; the size is ``image_width`` and
    ``image_height``, or ``width`` and ``height``. ``distortion_model`` or ``lens_model`` is a name of the model of
    Brown and Conrady (``plumb_bob``, ``radtan``, ``rational_polynomial`` with zeros from k4 on) or,
    as ``fisheye_model: 1``, of that of Kannala and Brandt (``fisheye``, ``equidistant``), in any case; another key with
    ``model`` or ``type`` in its name counts where its value is the model of a lens. Other keys do not count, but those
    that seem to have a second matrix or coefficients of the lens (``coeffs``, ``k1``, ``intrinsics``) are refused, and
    so are without width and height those that seem to have the size (``image_size``, ``resolution``, ``img_shape``, of
    which some have the height first), an image that is binned (``binning_x``, ``binning_y``) and one that is a part of
    the calibrated one (``roi``).

    Raises
    ------
    ScenarioError
        A file that cannot be read, or the first thing that is wrong with it.
    """
    source = path_text("path", path)
    text = read_text(path, "YAML").removeprefix("\ufeff")
    if text.lstrip().startswith("<"):
        raise ScenarioError(
            "expected a calibration in YAML or JSON, got XML; cv2.FileStorage writes them to a file whose name ends in "
            ".yml or .json",
            source,
        )
    text = re.sub(r"\A%YAML[^\n]*\n", "", text)  # %YAML:1.0 is none; a matrix is a mapping all the same
    text = re.sub(r"(\S[ \t]*\n)---\s*\Z", r"\1", text)  # ends each message that `ros2 topic echo` prints
    document = load_yaml(re.sub(r"(?m)^(\s*\w+\s*:)\s*!!opencv-(?:nd-)?matrix\s*$", r"\1", text), source)
    try:
        if not isinstance(document, dict):
            raise ValueError(f"expected a calibration with the key camera_matrix, got {shown_value(document)}")
        return _from_document(document)
    except ValueError as error:
        raise ScenarioError(str(error), source) from None


def _from_document(document: dict[str, Any]) -> dict[str, Any]:
    name = _given(document, _MATRICES)
    if name is None:
        raise ValueError(f"expected the key camera_matrix, got the keys {', '.join(map(str, document))}")
    matrix = _matrix(name, document[name])
    if matrix.shape == (9,):  # as a message of ROS has it
        matrix = matrix.reshape(3, 3)
    coefficients = _given(document, _COEFFICIENTS)
    _require_used(document, name, coefficients)
    size = [None if key is None else document[key] for key in (_given(document, _WIDTHS), _given(document, _HEIGHTS))]
    _require_known_size(document, size)
    _require_full_image(document, size)
    return camera_from_opencv(
        matrix,
        None if coefficients is None else _matrix(coefficients, document[coefficients]),
        None if size == [None, None] else size,  # type: ignore[arg-type]  # checked there
        model=_model(document),
    )


def _given(document: dict[str, Any], names: tuple[str, ...]) -> str | None:
    """Return the first of some keys that a document has, or None."""
    return next((name for name in names if document.get(name) is not None), None)


def _require_used(document: dict[str, Any], matrix: str, coefficients: str | None) -> None:
    """Refuse numbers of the camera under a name that is not known, or under two: without them it would be another."""
    for key, value in document.items():
        name = str(key).lower()
        if value is None or key in (matrix, coefficients) or _OF_MODEL.search(name) or _DEVIATIONS.search(name):
            continue
        if _OF_OTHER_IMAGE.search(name):
            raise ValueError(
                f"{key}: expected no such key, got the camera matrix of images that were rectified; drop it for the "
                f"images of {matrix}"
            )
        if key in _COEFFICIENTS:
            raise ValueError(f"{key}: expected the coefficients once, got {coefficients} too; drop one of the two")
        if name.replace("_", "") in _OF_MATRIX:
            raise ValueError(f"{key}: expected the camera matrix once, got {matrix} too; drop one of the two")
        several = isinstance(value, (list, dict))
        if (several and _OF_LENS.search(name)) or (not several and _COEFFICIENT.search(name)):
            raise ValueError(
                f"{key}: expected no such key, got {shown_value(value)}; if these are the coefficients of the lens, "
                f"name them {_COEFFICIENTS[0]}, in one list, else drop the key"
            )


def _require_known_size(document: dict[str, Any], size: list[Any]) -> None:
    """Refuse a size of the image under a name that is not known: without it the image would have no border."""
    if size != [None, None]:
        return
    for key, value in document.items():
        if value is not None and _OF_SIZE.search(str(key).lower().replace("_", "")):
            raise ValueError(
                f"{key}: expected no such key, got {shown_value(value)}; if this is the size of the image, name it "
                f"{_WIDTHS[0]} and {_HEIGHTS[0]}, else drop the key"
            )


def _require_full_image(document: dict[str, Any], size: list[Any]) -> None:
    """Refuse an image that is binned or a part of the calibrated one, whose pixels are others than the matrix has."""
    for key in ("binning_x", "binning_y"):
        if (value := document.get(key)) not in (None, 0, 1):
            raise ValueError(
                f"{key}: expected 0 or 1, an image that is not binned, got {shown_value(value)}; give the calibration "
                "of the images that the program has, without this key"
            )
    part = document.get("roi")
    if isinstance(part, list) and len(part) == 4:  # of cv2.getOptimalNewCameraMatrix
        part = dict(zip(("x_offset", "y_offset", "width", "height"), part, strict=True))
    if not isinstance(part, dict):
        return
    whole = {"x_offset": (0,), "y_offset": (0,), "width": (0, size[0]), "height": (0, size[1])}
    for key, allowed in whole.items():
        if (value := part.get(key)) is not None and value not in allowed:
            raise ValueError(
                f"roi.{key}: expected {' or '.join(str(one) for one in allowed if one is not None)}, the whole image, "
                f"got {shown_value(value)}; give the calibration of the images that the program has, without roi"
            )


def _model(document: dict[str, Any]) -> _Model:
    """Return the model of the lens by the keys of a file; without them that of ``cv2.calibrateCamera``."""
    found: dict[str, _Model] = {}  # by key
    for key, value in document.items():
        if value is None or not _OF_MODEL.search(str(key).lower()):
            continue
        if key == _FISHEYE:
            found[key] = _of_fisheye(value)
            continue
        name = re.sub(r"[\s-]+", "_", str(value).strip().lower())
        if name in _NO_MODEL or (name not in (*_MODELS, *_OTHER_MODELS) and str(key).lower() not in _LENS_MODELS):
            continue  # of the camera or the pattern
        if name not in _MODELS:
            raise ValueError(
                f"{key}: expected one of {', '.join(_MODELS)}, got {shown_value(value)}; drop the key if it is not the "
                "model of the lens"
            )
        found[key] = _MODELS[name]
    if len(set(found.values())) > 1:
        (one, first), (other, _) = next((a, b) for a, b in pairwise(found.items()) if a[1] != b[1])
        wanted = "fisheye" if first == "kannala_brandt" else "plumb_bob"
        raise ValueError(
            f"{other}: expected {wanted} beside {one}: {document[one]}, got {shown_value(document[other])}; drop one"
        )
    return next(iter(found.values()), "brown_conrady")


def _of_fisheye(value: Any) -> _Model:
    """Return the model by ``fisheye_model``, whose number OpenCV writes plain and others as text."""
    text = str(value).strip().lower()
    if text not in ("0", "1", "false", "true"):
        raise ValueError(f"{_FISHEYE}: expected 0 or 1, got {shown_value(value)}")
    return "kannala_brandt" if text in ("1", "true") else "brown_conrady"


def _matrix(name: str, value: Any) -> Array:
    """Return what a file has as a matrix: a mapping with rows, cols and data, or nested lists."""
    if not isinstance(value, dict):
        return _numbers(name, value, None)
    rows, columns, data = value.get("rows"), value.get("cols"), value.get("data")
    if isinstance(sizes := value.get("sizes"), list):  # of an array with one axis, or with more than two
        rows, columns = [*sizes, 1, 1][:2]
    if not (isinstance(rows, int) and isinstance(columns, int) and isinstance(data, list)):
        raise ValueError(f"{name}: expected rows, cols and data, got {shown_value(value)}")
    numbers = _numbers(f"{name}.data", data, None)
    if numbers.ndim != 1 or numbers.size != rows * columns or rows < 0:
        raise ValueError(f"{name}.data: expected {rows} x {columns} numbers, got {numbers.size}")
    return numbers.reshape(rows, columns)


def _coefficients(distortion: ArrayLike, model: str) -> list[float]:
    """Return all coefficients of a model; none where none are given, as ROS and OpenCV have an undistorted image."""
    numbers = _numbers("distortion", distortion, None).ravel()
    count = _BROWN_CONRADY if model == "brown_conrady" else _KANNALA_BRANDT
    if not len(numbers):
        if model == "kannala_brandt":
            raise ValueError(
                "distortion: expected k1 to k4 (4 numbers), got none; give [0, 0, 0, 0] for an equidistant lens, "
                "or another model for images without distortion"
            )
        return []
    if len(numbers) < 4 or np.any(numbers[count:]):
        what = "k1, k2, p1, p2 and k3 (4 or 5 numbers)" if model == "brown_conrady" else "k1 to k4 (4 numbers)"
        raise ValueError(f"distortion: expected {what}, got {shown_value(numbers.tolist())}")
    kept: list[float] = numbers[:count].tolist()
    return kept + [0.0] * (count - len(kept))


def _numbers(name: str, value: Any, shape: tuple[int, ...] | None) -> Array:
    numbers = real_numbers(value)
    if numbers is None:
        raise ValueError(f"{name}: expected real numbers, got {shown_value(plain(value))}")
    if shape is not None and numbers.shape != shape:
        raise ValueError(f"{name}: expected {' x '.join(map(str, shape))} numbers, got the shape {numbers.shape}")
    if not np.isfinite(numbers).all():
        raise ValueError(f"{name}: expected finite numbers, got {shown_value(numbers.tolist())}")
    return numbers
