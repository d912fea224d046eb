"""Point clouds from files, and what is refused."""

from io import BytesIO
from pathlib import Path

import laspy
import numpy as np
import pytest

from ptnsbc_core.types import Array
from ptnsbc_io.point_cloud_file import PointCloudFileError, read_points

POINTS = np.array([[1.0, 2.0, 3.0], [-4.5, 0.25, 6.0], [7.0, 8.0, -9.0]])


def header(data: str, points: int = 3, fields: str = "x y z", kinds: str = "F F F") -> str:
    size = " ".join("4" for _ in fields.split())
    return (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {size}\nTYPE {kinds}\n"
        f"WIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA {data}\n"
    )


FACE = b"3 0 1 2\n"


def ply(form: str, properties: str = "x y z", vertices: str = "3") -> str:
    lines = "".join(f"property float {name}\n" for name in properties.split())
    faces = "element face 1\nproperty list uchar int vertex_indices\n"
    return f"ply\nformat {form} 1.0\nelement vertex {vertices}\n{lines}{faces}end_header\n"


def rows(points: Array) -> str:
    return "".join(" ".join(map(str, row)) + "\n" for row in points.tolist())


def written(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def points_of(path: Path) -> Array:
    return read_points(path.suffix.lower(), path.read_bytes())


def test_every_form_holds_the_same_points(tmp_path: Path) -> None:
    single = POINTS.astype("<f4")
    np.save(tmp_path / "a.npy", POINTS)
    files = [
        tmp_path / "a.npy",
        written(tmp_path, "a.csv", "x,y,z\n" + rows(POINTS).replace(" ", ",")),
        written(tmp_path, "a.xyz", "//X Y Z R\n" + rows(POINTS).replace("\n", " 9\n")),
        written(tmp_path, "b.csv", "# a scan\n" + rows(POINTS).replace(" ", ",")),
        written(
            tmp_path, "c.csv", "\ufeff" + rows(POINTS).replace(" ", ",")
        ),  # Excel: its first row counts
        written(
            tmp_path,
            "d.csv",
            "intensity,x,y,z\n" + "".join(f"9,{x},{y},{z}\n" for x, y, z in POINTS.tolist()),
        ),
        written(tmp_path, "a.pcd", header("ascii") + rows(POINTS)),
        written(tmp_path, "a.ply", ply("ascii").encode() + rows(POINTS).encode() + FACE),
        written(tmp_path, "b.ply", ply("binary_little_endian").encode() + single.tobytes()),
        written(
            tmp_path, "c.PLY", ply("binary_big_endian").encode() + POINTS.astype(">f4").tobytes()
        ),
        written(tmp_path, "b.PCD", header("binary").encode() + single.tobytes()),
    ]
    for path in files:
        np.testing.assert_array_equal(points_of(path), POINTS)


@pytest.mark.parametrize("name", ["a.las", "a.LAZ"])
def test_points_of_a_survey_are_read(tmp_path: Path, name: str) -> None:
    cloud = laspy.create(point_format=3, file_version="1.2")
    cloud.header.scales = [0.01, 0.01, 0.01]
    cloud.x, cloud.y, cloud.z = POINTS.T
    made = BytesIO()
    cloud.write(made, do_compress=name.endswith("Z"))
    np.testing.assert_allclose(points_of(written(tmp_path, name, made.getvalue())), POINTS)


@pytest.mark.parametrize("missing", ["laspy", "lazrs"])
def test_a_survey_needs_a_library_that_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    found = "ptnsbc_io.point_cloud_file.find_spec"
    monkeypatch.setattr(found, lambda name: None if name == missing else name)
    with pytest.raises(PointCloudFileError, match=r'pip install "ptnsbc\[maps\]"'):
        points_of(written(tmp_path, "a.las", b""))


def packed(tokens: list[bytes], size: int = 36) -> bytes:
    content = b"".join(tokens)
    return len(content).to_bytes(4, "little") + size.to_bytes(4, "little") + content


def test_a_compressed_pcd_holds_column_after_column(tmp_path: Path) -> None:
    """Runs of bytes, a short copy, and a long one that repeats what it has just written."""
    points = np.zeros((12, 3))
    points[:, 0], points[:4, 1] = 1.5, (2.0, 2.0, -7.0, 2.0)
    data = points.astype("<f4").T.tobytes()
    x, y = data[:4], data[48:64]
    tokens = [b"\3" + x, b"\xe0" + bytes([44 - 9, 3])]  # 44 bytes more of x
    tokens += [b"\3" + y[:4], b"\x40\3", b"\3" + y[8:12], b"\x40\x0b"]  # y, with copies of 4 bytes
    tokens += [b"\0\0", b"\xe0" + bytes([78 - 9, 0]), b"\0\0"]
    path = written(
        tmp_path, "a.pcd", header("binary_compressed", 12).encode() + packed(tokens, 144)
    )
    np.testing.assert_array_equal(points_of(path), points)


def test_other_fields_of_a_pcd_are_skipped(tmp_path: Path) -> None:
    record = np.dtype([("i", "<u4"), ("z", "<f4"), ("n", "<f4", (3,)), ("x", "<f4"), ("y", "<f4")])
    given = np.zeros(3, record)
    for axis, column in zip("xyz", POINTS.T, strict=True):
        given[axis] = column
    text = header("binary", fields="i z n x y", kinds="U F F F F")
    text = text.replace("WIDTH", "COUNT 1 1 3 1 1\nWIDTH")
    path = written(tmp_path, "a.pcd", text.encode() + given.tobytes())
    np.testing.assert_array_equal(points_of(path), POINTS)
    flat = "".join(f"7 {z} 0 0 0 {x} {y}\n" for x, y, z in POINTS.tolist())
    path = written(tmp_path, "b.pcd", text.replace("binary", "ascii") + flat)
    np.testing.assert_array_equal(points_of(path), POINTS)


def test_other_properties_of_a_ply_are_skipped(tmp_path: Path) -> None:
    text = ply("ascii", "nx x y z red")
    path = written(
        tmp_path, "a.ply", text + "".join(f"9 {row} 7\n" for row in rows(POINTS).split("\n") if row)
    )
    np.testing.assert_array_equal(points_of(path), POINTS)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.ply", "plyx\n", "with a line end_header"),
        ("a.ply", ply("ascii 9").replace("ascii", "text"), "format text: expected ascii"),
        ("a.ply", ply("ascii", "x y"), "expected fields x, y and z, each"),
        ("a.ply", ply("ascii", vertices="-1"), "element vertex -1: expected whole numbers"),
        ("a.ply", ply("ascii", vertices="0"), "no points: expected at least one"),
        ("a.ply", ply("ascii").replace("vertex 3", "edge 3"), "expected vertices as the first"),
        ("a.ply", ply("ascii").replace("float x", "list uchar int x"), "a property of one number"),
        ("a.ply", ply("ascii") + "1 2 3\n", "1 points: expected 3"),
        ("a.ply", ply("ascii") + "1 2\n" * 3, "a row of numbers for each point"),
        ("a.ply", ply("binary_little_endian") + "abc", "expected 36 bytes of points, found 3"),
        ("a.bt", "", "octree2pointcloud"),
        ("a.ot", "", "convert_octree"),
    ],
)  # fmt: skip
def test_what_is_no_ply_is_refused(tmp_path: Path, name: str, content: str, message: str) -> None:
    with pytest.raises(PointCloudFileError, match=message):
        points_of(written(tmp_path, name, content))


def test_points_that_are_no_numbers_are_left_out(tmp_path: Path) -> None:
    path = written(tmp_path, "a.pcd", header("ascii", 4) + "nan nan nan\n" + rows(POINTS))
    np.testing.assert_array_equal(points_of(path), POINTS)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (
            "a.txt",
            "",
            r"expected a file that ends in \.pcd, \.ply, \.csv, \.xyz, \.npy, \.las, \.laz",
        ),
        ("a.las", "", "expected a LAS or LAZ file that laspy reads"),
        ("a.laz", b"LASF" + bytes(400), "expected a LAS or LAZ file that laspy reads"),
        ("a.csv", "", "no points: expected at least one"),
        ("a.csv", "x,y,z\n", "no points: expected at least one"),
        ("a.csv", "1,2\n3,4\n", "row 1: 2 numbers: expected x, y, z"),
        ("a.csv", "1,2,3\n4,five,6\n", "row 2: expected numbers x, y, z"),
        ("a.csv", "lat,lon,z\n9,1,2\n", "row 1: column lat, lon, z: expected one named x, in m"),
        ("a.csv", b"\xff\xfe1,2,3", "byte 0: expected UTF-8 text"),
        ("a.csv", "nan,0,0\n", "no points"),
        ("a.csv", "1e7,0,0\n", "expected no coordinate beyond"),
        ("a.npy", "text", r"expected an array that numpy\.save has written"),
        ("a.npy", b"PK\3\4" + bytes(60), r"expected an array that numpy\.save has written"),
        ("a.pcd", "", "expected the header of a PCD file"),
        ("a.pcd", "FIELDS x y z\nDATA ascii\n", "expected a line SIZE in the header"),
        ("a.pcd", header("ascii"), "0 points: expected 3"),
        ("a.pcd", header("ascii", 0) + "1 2 3\n", "no points: expected at least one"),
        ("a.pcd", header("ascii") + "1 2 3\n", "1 points: expected 3"),
        ("a.pcd", header("ascii") + "1 2 3\n1 2\n1 2 3\n", "expected a row of numbers for each"),
        ("a.pcd", header("ascii") + "# 1 2 3\n", "expected a row of numbers for each"),
        ("a.pcd", header("binary") + "1234", "expected 36 bytes of points, found 4"),
        ("a.pcd", header("packed") + "1234", "DATA packed: expected ascii, binary or binary_comp"),
        ("a.pcd", header("binary_compressed") + "1234", "expected 36 bytes of points, found 0"),
        ("a.pcd", header("binary_compressed").encode() + packed([b"\xe0"] * 9), "found 0"),
        ("a.pcd", header("ascii", fields="x y i"), "expected fields x, y and z, each"),
        ("a.pcd", header("ascii", kinds="F F Q"), "field z: Q4: expected a type of PCD"),
        ("a.pcd", header("ascii", kinds="F F"), "expected as many words in FIELDS"),
        ("a.pcd", header("ascii").replace("POINTS 3", "POINTS -3"), "POINTS -3: expected whole"),
        (
            "a.pcd",
            header("ascii").replace("WIDTH", "COUNT 1 2 1\nWIDTH"),
            "expected fields x, y and z, each of one number",
        ),
    ],
)
def test_what_is_no_point_cloud_is_refused(
    tmp_path: Path, name: str, content: str | bytes, message: str
) -> None:
    with pytest.raises(PointCloudFileError, match=message):
        points_of(written(tmp_path, name, content))


@pytest.mark.parametrize("header", ["{'descr': (", "\0{}", "{'a\x1d': 1}", "{'shape': (1, 3)}", ""])
def test_an_array_with_a_damaged_header_is_refused(tmp_path: Path, header: str) -> None:
    data = b"\x93NUMPY\1\0" + len(header).to_bytes(2, "little") + header.encode() + bytes(24)
    with pytest.raises(PointCloudFileError, match=r"an array that numpy\.save has written"):
        points_of(written(tmp_path, "a.npy", data))


def test_an_array_of_another_shape_is_refused(tmp_path: Path) -> None:
    for odd in (np.zeros(3), np.zeros((4, 2)), np.zeros((3, 60)), np.array([["a", "b", "c"]])):
        np.save(tmp_path / "a.npy", odd)
        with pytest.raises(
            PointCloudFileError, match=r"expected an array of|expected \(N, 3\), a row"
        ):
            points_of(tmp_path / "a.npy")
