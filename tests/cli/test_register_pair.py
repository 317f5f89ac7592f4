"""`register --fixed --moving` and `evaluate` on files that SimpleITK and plain text made."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK
from html_outline import outline_of
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner, Result

from dvf_ig.cli.main import app
from dvf_ig.core import Rigid, Stop, Volume
from dvf_ig.registration import RegistrationResult, register_pair

CENTER = np.array([21.0, -34.0, 48.0])
TURN = Rotation.from_rotvec([0.06, -0.05, 0.07]).as_matrix()
SHIFT = np.array([4.0, -3.0, 3.5])
POINTS = CENTER + np.array([[0, 0, 0], [15, 5, -6], [-12, 9, 10], [3, -14, 8], [8, 12, 14.0]])


def moving_of(fixed_mm: np.ndarray) -> np.ndarray:
    """The truth: LPS mm of the fixed image to LPS mm of the moving image."""
    return (fixed_mm - CENTER) @ TURN.T + CENTER + SHIFT


def organ(moving_mm: np.ndarray) -> np.ndarray:
    """Four lobes in a body: 100, lobes 200 or 20."""
    q = moving_mm - CENTER - SHIFT
    out = np.where(np.linalg.norm(q / (34, 30, 32), axis=-1) < 1, 100.0, 10.0)
    for level, middle, radii in (
        (200, (-12, 4, -6), (9, 12, 7)),
        (200, (13, -8, 5), (6, 7, 13)),
        (20, (2, 12, 12), (12, 6, 8)),
        (20, (4, -6, -15), (7, 10, 6)),
    ):
        out[np.linalg.norm((q - middle) / radii, axis=-1) < 1] = level
    return out


def centers_mm(image: SimpleITK.Image) -> np.ndarray:
    size = image.GetSize()
    index = np.stack(np.meshgrid(*(np.arange(n) for n in size), indexing="ij"), axis=-1)
    axes = np.array(image.GetDirection()).reshape(3, 3) * image.GetSpacing()
    return index @ axes.T + np.array(image.GetOrigin())


def empty(size: tuple[int, int, int], spacing: tuple[float, ...], turn: tuple[float, ...]) -> SimpleITK.Image:
    """An oblique image of that size about the organ."""
    image = SimpleITK.Image(size, SimpleITK.sitkFloat32)
    direction = Rotation.from_euler("xyz", turn, degrees=True).as_matrix()
    image.SetSpacing(spacing)
    image.SetDirection(direction.ravel().tolist())
    image.SetOrigin((CENTER - direction @ (np.array(spacing) * (np.array(size) - 1) / 2)).tolist())
    return image


def filled(image: SimpleITK.Image, values: np.ndarray) -> SimpleITK.Image:
    made = SimpleITK.GetImageFromArray(values.T.astype(np.float32))
    made.CopyInformation(image)
    return made


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """us.nii.gz: bright borders, dark fluid, speckle, zeros outside a ball; mr.nii.gz on another grid."""
    folder = tmp_path_factory.mktemp("pair")
    rng = np.random.default_rng(4)
    blank = empty((50, 48, 46), (1.3, 1.3, 1.4), (15.0, -10.0, 30.0))
    places = centers_mm(blank)
    seen = organ(moving_of(places))
    speckle = np.hypot(rng.normal(size=seen.shape), rng.normal(size=seen.shape))
    grey = 40 + 20 * np.log10(np.select([seen < 50, seen > 150], [0.05, 2.0], 0.5) * speckle + 1e-3)
    inside = np.linalg.norm(places - CENTER, axis=-1) < 29
    SimpleITK.WriteImage(
        filled(blank, np.where(inside, np.clip(grey, 0, None), 0)), str(folder / "us.nii.gz")
    )
    blank = empty((56, 60, 40), (1.5, 1.4, 2.0), (-20.0, 5.0, 10.0))
    level = organ(centers_mm(blank))
    mr = filled(blank, level + rng.normal(0, 4, level.shape))
    SimpleITK.WriteImage(mr, str(folder / "mr.nii.gz"))
    mr.SetOrigin((np.array(mr.GetOrigin()) + 400).tolist())
    SimpleITK.WriteImage(mr, str(folder / "elsewhere.nii.gz"))
    return folder


def invoke(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def markups(path: Path, lps_mm: np.ndarray, names: list[str], system: str = "LPS") -> Path:
    signs = np.array([1, 1, 1] if system == "LPS" else [-1, -1, 1])
    if path.suffix == ".fcsv":
        rows = "".join(
            f"{i},{x:.9f},{y:.9f},{z:.9f},0,0,0,1,1,1,0,{name}\n"
            for i, (name, (x, y, z)) in enumerate(zip(names, lps_mm * signs, strict=True))
        )
        path.write_text(
            f"# Markups fiducial file version = 4.11\n# CoordinateSystem = {system}\n"
            f"# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label\n{rows}"
        )
        return path
    points = [{"label": n, "position": p} for n, p in zip(names, (lps_mm * signs).tolist(), strict=True)]
    markup = {"type": "Fiducial", "coordinateSystem": system, "controlPoints": points}
    path.write_text(json.dumps({"markups": [markup]}))
    return path


def tag(path: Path, first_lps: np.ndarray, second_lps: np.ndarray) -> Path:
    rows = "\n".join(
        " " + " ".join(f"{v:.9f}" for v in (*(a * [-1, -1, 1]), *(b * [-1, -1, 1]))) + f' "p{i}"'
        for i, (a, b) in enumerate(zip(first_lps, second_lps, strict=True))
    )
    path.write_text(f"MNI Tag Point File\nVolumes = 2;\n% made by hand\n\nPoints =\n{rows};\n")
    return path


@dataclass(frozen=True)
class Registered:
    """Registration of the two files: a folder to be read alone, the printed JSON, and the result."""

    folder: Path
    printed: dict[str, Any]
    result: RegistrationResult


@pytest.fixture(scope="module")
def registered(files: Path, tmp_path_factory: pytest.TempPathFactory) -> Registered:
    out = tmp_path_factory.mktemp("registered")
    results: list[RegistrationResult] = []

    def keeping(*given: Any, **options: Any) -> RegistrationResult:
        results.append(register_pair(*given, **options))
        return results[0]

    pair = ("register", "--fixed", files / "us.nii.gz", "--moving", files / "mr.nii.gz")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dvf_ig.registration.register_pair", keeping)
        done = invoke(*pair, "-o", out, "--json")
    assert done.exit_code == 0, done.output
    return Registered(out, json.loads(done.stdout), results[0])


@dataclass
class Stub:
    """In place of the registration of a pair: a result, and what the last call was given."""

    result: RegistrationResult
    anatomies: Sequence[Volume] = ()
    start: Rigid | None = None

    def __call__(
        self, _: Volume, anatomies: Sequence[Volume], start: Rigid, **options: Any
    ) -> RegistrationResult:
        self.anatomies, self.start = anatomies, start
        return self.result


@pytest.fixture
def stub(registered: Registered, monkeypatch: pytest.MonkeyPatch) -> Stub:
    """Stub with the result of `registered`."""
    stub = Stub(registered.result)
    monkeypatch.setattr("dvf_ig.registration.register_pair", stub)
    return stub


def test_a_pair_of_files_is_registered_and_its_error_evaluated(
    registered: Registered, tmp_path: Path
) -> None:
    out, result = registered.folder, registered.printed
    assert result["stop"] == "CONVERGED"
    assert (out / "moving_from_fixed.h5").is_file()
    transform = SimpleITK.ReadTransform(str(out / "moving_from_fixed.tfm"))
    written = np.array([transform.TransformPoint(p) for p in POINTS.tolist()])
    matrix = np.array(result["moving_from_fixed"])
    np.testing.assert_allclose(written, POINTS @ matrix[:3, :3].T + matrix[:3, 3], atol=1e-9)
    errors = np.linalg.norm(written - moving_of(POINTS), axis=1)
    assert np.linalg.norm(moving_of(POINTS) - POINTS, axis=1).mean() > 5
    assert errors.mean() < 0.7  # half a voxel of the ultrasound
    names = [f"p{i}" for i in range(len(POINTS))]
    fixed = markups(tmp_path / "fixed.mrk.json", POINTS, names, "RAS")
    moving = markups(tmp_path / "moving.fcsv", moving_of(POINTS), names)
    said = invoke("evaluate", "--transform", out, "--landmarks", fixed, moving, "--json")
    assert json.loads(said.stdout)["tre_mm"]["mean"] == pytest.approx(errors.mean(), abs=1e-6)


def test_several_contrasts_are_registered_together_in_place_of_one(
    files: Path, registered: Registered, stub: Stub, tmp_path: Path
) -> None:
    out = Path(shutil.copytree(registered.folder, tmp_path / "out"))
    mr, t2 = files / "mr.nii.gz", tmp_path / "t2.nii.gz"
    blank = empty((5, 6, 4), (1.6, 1.7, 1.7), (5.0, 25.0, -15.0))
    SimpleITK.WriteImage(filled(blank, np.arange(120.0).reshape(5, 6, 4)), str(t2))
    done = invoke("register", "--fixed", files / "us.nii.gz", "--moving", mr, "--moving", t2, "-o", out)
    assert done.exit_code == 0, done.output
    assert [anatomy.grid.shape for anatomy in stub.anatomies] == [(56, 60, 40), (5, 6, 4)]
    assert "mr.nii.gz and t2.nii.gz" in (out / "report.html").read_text(encoding="utf-8")


def test_the_page_beside_the_transform_holds_the_same_numbers(
    registered: Registered,
) -> None:
    out, result = registered.folder, registered.printed
    page = (out / "report.html").read_text(encoding="utf-8")
    outline = outline_of(page)
    assert outline.faults == []
    assert {entry for entry in outline.loaded if not entry.startswith("img data:")} == {"a view.html"}
    assert '"kind":"registration"' in (out / "view.html").read_text(encoding="utf-8")
    assert len(outline.images) == 3 * 5
    assert len(page) < 3e6
    assert "us.nii.gz" in page
    assert "This registration may be used" in page
    for value in np.array(result["moving_from_fixed"])[:3].ravel():
        assert f"<td>{value + 0.0:.4f}</td>" in page
    assert f"{result['start_similarity']:.3f} at the start, {result['similarity']:.3f} registered" in page
    assert f"<td>{result['pair_statistic']:.1f} (parts disagree by" in page
    assert f"<td>{result['contrast']:.1f}</td><td>at least 0.0</td>" in page
    assert f"<td>{result['disagreement_mm']:.2f} mm</td>" in page
    assert "not checked" not in page, "a pair shows the checks that apply to it"


def test_a_page_of_the_users_own_is_kept(files: Path, tmp_path: Path) -> None:
    own = tmp_path / "report.html"
    own.write_text("<p>my notes</p>")
    done = invoke("register", "--fixed", files / "us.nii.gz", "--moving", files / "mr.nii.gz", "-o", tmp_path)
    assert done.exit_code == 4
    assert "report.html" in done.output
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    assert own.read_text() == "<p>my notes</p>"


def test_a_refused_pair_has_its_page_marked(files: Path, stub: Stub, tmp_path: Path) -> None:
    stub.result = replace(stub.result, stop=Stop.AMBIGUOUS)
    pair = ("register", "--fixed", files / "us.nii.gz", "--moving", files / "mr.nii.gz")
    done = invoke(*pair, "-o", tmp_path / "out")
    assert done.exit_code in (6, 7), done.output
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "✕ REFUSED: this registration must not be used" in page
    assert (tmp_path / "out" / "moving_from_fixed.tfm").is_file()


def test_images_that_do_not_meet_are_told_to_need_a_start(files: Path, tmp_path: Path) -> None:
    arguments = ("register", "--fixed", files / "us.nii.gz", "--moving", files / "elsewhere.nii.gz")
    refused = invoke(*arguments, "-o", tmp_path / "refused")
    assert refused.exit_code == 5
    assert "0 % of the ultrasound lies inside the moving image at the start pose" in refused.output
    assert "--init FILE.tfm" in refused.output


def test_a_registration_begins_at_the_start_of_a_file(files: Path, stub: Stub, tmp_path: Path) -> None:
    start = SimpleITK.AffineTransform(3)
    start.SetTranslation([402.0, 397.0, 401.0])
    SimpleITK.WriteTransform(start, str(tmp_path / "start.tfm"))
    pair = ("register", "--fixed", files / "us.nii.gz", "--moving", files / "elsewhere.nii.gz")
    done = invoke(*pair, "--init", tmp_path / "start.tfm", "-o", tmp_path / "there.tfm", "--json")
    assert done.exit_code == 0, done.output
    assert stub.start is not None
    assert (stub.start.target, stub.start.source) == ("moving", "fixed")
    np.testing.assert_array_equal(stub.start.matrix[:3, 3], [402.0, 397.0, 401.0])
    assert f"wrote {tmp_path / 'there.html'}" in done.stderr
    assert "a there.view.html" in outline_of((tmp_path / "there.html").read_text(encoding="utf-8")).loaded
    assert (tmp_path / "there.view.html").is_file()
    transform = SimpleITK.ReadTransform(str(tmp_path / "there.tfm"))
    written = np.array([transform.TransformPoint(p) for p in POINTS.tolist()])
    pose = stub.result.target_from_source
    np.testing.assert_allclose(written, pose.apply_array(POINTS), atol=1e-9)


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The true transform off by (0, 3, 4) mm on the moving side, as SimpleITK writes it, with its centre."""
    folder = tmp_path_factory.mktemp("truth")
    transform = SimpleITK.AffineTransform(3)
    transform.SetCenter(CENTER.tolist())
    transform.SetMatrix(TURN.ravel().tolist())
    transform.SetTranslation(np.add(SHIFT, [0, 3, 4]).tolist())
    SimpleITK.WriteTransform(transform, str(folder / "off.tfm"))
    (folder / "off.json").write_text('{"from": "fixed", "to": "moving"}')
    return folder / "off.tfm"


@pytest.mark.parametrize("system", ["LPS", "RAS"])
@pytest.mark.parametrize("ending", [".mrk.json", ".fcsv"])
def test_a_known_shift_is_the_error_in_every_file_format(
    truth: Path, tmp_path: Path, ending: str, system: str
) -> None:
    names = [f"p{i}" for i in range(len(POINTS))]
    fixed = markups(tmp_path / f"fixed{ending}", POINTS, names, system)
    moving = markups(tmp_path / f"moving{ending}", moving_of(POINTS)[::-1], names[::-1], system)
    done = invoke("evaluate", "--transform", truth, "--landmarks", fixed, moving, "--json")
    assert done.exit_code == 0, done.output
    tre = json.loads(done.stdout)["tre_mm"]
    np.testing.assert_allclose([tre["mean"], tre["median"], tre["p95"], tre["max"]], 5.0, atol=1e-6)
    assert tre["n"] == len(POINTS)
    swapped = invoke("evaluate", "--transform", truth, "--landmarks", moving, fixed, "--json")
    assert json.loads(swapped.stdout)["tre_mm"]["mean"] > 6  # a transform has a direction


def test_a_tag_pair_in_either_order(truth: Path, tmp_path: Path) -> None:
    usual = tag(tmp_path / "usual.tag", POINTS, moving_of(POINTS))
    other = tag(tmp_path / "other.tag", moving_of(POINTS), POINTS)
    for arguments in ((usual,), (other, "--moving-first")):
        done = invoke("evaluate", "--transform", truth, "--landmarks", *arguments, "--json")
        assert json.loads(done.stdout)["tre_mm"]["max"] == pytest.approx(5.0, abs=1e-6)


def test_a_tag_pair_that_states_its_order_needs_no_option(truth: Path, tmp_path: Path) -> None:
    """RESECT's own files say MRI first, and mean it."""
    pair = tag(tmp_path / "pair.tag", moving_of(POINTS), POINTS)
    silent = invoke("evaluate", "--transform", truth, "--landmarks", pair)
    assert "does not say which side comes first" in silent.output
    pair.write_text(pair.read_text().replace("\n\n", "\n% Case 2: MRI-beforeUS landmarks\n\n", 1))
    stated = invoke("evaluate", "--transform", truth, "--landmarks", pair)
    assert "its first side is the MR" in stated.output
    assert "5.00 mm mean" in stated.output


def test_exchanged_names_and_metres_are_named(truth: Path, tmp_path: Path) -> None:
    names = [f"p{i}" for i in range(len(POINTS))]
    fixed = markups(tmp_path / "fixed.fcsv", POINTS, names)
    other = markups(tmp_path / "other.fcsv", moving_of(POINTS), ["p0", "p3", "p2", "p1", "p4"])
    swapped = invoke("evaluate", "--transform", truth, "--landmarks", fixed, other)
    assert "the names p1 and p3 are exchanged on one side" in swapped.output
    for marked, moving, named in (
        (fixed, moving_of(POINTS) / 1000, "m.fcsv"),
        (None, moving_of(POINTS), "small.fcsv"),
    ):
        first = marked or markups(tmp_path / "small.fcsv", POINTS / 1000, names)
        refused = invoke(
            "evaluate",
            "--transform",
            truth,
            "--landmarks",
            first,
            markups(tmp_path / "m.fcsv", moving, names),
        )
        assert refused.exit_code == 3
        assert f"{named}: its points: the set is 0.0" in refused.output
        assert "it is in m (then" in refused.output


def test_landmarks_that_do_not_pair_up_get_one_sentence(truth: Path, tmp_path: Path) -> None:
    names = [f"p{i}" for i in range(len(POINTS))]
    fixed = markups(tmp_path / "fixed.fcsv", POINTS, names)
    other = markups(tmp_path / "other.fcsv", moving_of(POINTS), [f"q{i}" for i in range(len(POINTS))])
    few = markups(tmp_path / "few.fcsv", moving_of(POINTS)[:2], names[:2])
    for moving, shared in ((other, 0), (few, 2)):
        refused = invoke("evaluate", "--transform", truth, "--landmarks", fixed, moving)
        assert refused.exit_code == 3
        assert f"share {shared} names, needed at least 3" in refused.output
        assert refused.output.count("\n") == 1
    most = markups(tmp_path / "most.fcsv", moving_of(POINTS)[1:], names[1:])
    told = invoke("evaluate", "--transform", truth, "--landmarks", fixed, most)
    assert told.exit_code == 0
    assert "1 landmarks are on one side only and are left out: p0" in told.output
    alone = invoke("evaluate", "--transform", truth, "--landmarks", fixed)
    assert alone.exit_code == 3
    misplaced = invoke("evaluate", "--transform", truth, "--landmarks", fixed, most, "--moving-first")
    assert misplaced.exit_code == 3
    assert "--moving-first applies to one .tag file" in misplaced.output
