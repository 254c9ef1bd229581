"""Loading and saving beyond the round trip: plain files, versions, hashes, pairs, provenance."""

import h5py
import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError, UnitMismatch
from robustlab.provenance import NOT_VERIFIED
from robustlab.statespace import StateSpaceModel
from robustlab.storage import check_pair, read, save

A, B, C, D = np.diag([-1.0, -2.0]), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1))


@pytest.fixture
def model():
    return StateSpaceModel(A, B, C, D, 0.0, [("u", "V")], [("phi", "rad")], ["x", "v"])


def load(path, **options):
    return rl.load(path, isolate=False, **options)


def test_plain_file(tmp_path):
    with h5py.File(tmp_path / "p.h5", "w") as file:
        for name, value in zip("ABCD", (A.astype("f4"), B.astype(">f8"), C.astype("i2"), 0.0), strict=True):
            file[name] = value
        file.attrs["dt"] = 0.1
        file["notes"] = "ignored"
    model = load(tmp_path / "p.h5")
    np.testing.assert_array_equal(model.A, A)
    assert (model.dt, model.input_names, model.output_names) == (0.1, ("u1",), ("y1",))
    found = read(tmp_path / "p.h5", isolate=False)
    assert (found.verified, found.kind) == (False, "state-space")
    assert found.warnings == ("no unit stated for u1, y1",)


def test_newer_minor_version_with_unknown_parts_is_read(model, tmp_path):
    save(tmp_path / "p.h5", model)
    with h5py.File(tmp_path / "p.h5", "a") as file:
        file.attrs["format_version"] = "1.7"
        file["extra/thing"] = np.ones(3)
        del file.attrs["content_sha256"]
    found = read(tmp_path / "p.h5", isolate=False)
    np.testing.assert_array_equal(found.object.A, A)
    assert not found.verified
    assert "carries no content_sha256" in found.warnings[0]


@pytest.mark.parametrize(
    ("version", "text"), [("0.9", "no robustlab ever wrote"), ("1", "format_version is '1'"), ("x", "'x'")]
)
def test_odd_versions_are_refused(version, text, model, tmp_path):
    save(tmp_path / "p.h5", model)
    with h5py.File(tmp_path / "p.h5", "a") as file:
        file.attrs["format_version"] = version
    with pytest.raises(InputError, match=text):
        load(tmp_path / "p.h5")


def test_any_change_of_content_is_seen_and_provenance_is_not_content(model, tmp_path):
    def spoilt(change):
        save(tmp_path / "p.h5", model)
        with h5py.File(tmp_path / "p.h5", "a") as file:
            change(file)
        return tmp_path / "p.h5"

    def rename(file):
        file["signals/output/name"][0] = b"psi"

    for change in (
        lambda file: file["A"].write_direct(np.array([[0.0, 1.0], [2.0, 3.0]])),
        lambda file: file.attrs.__setitem__("dt", 0.5),
        lambda file: file.create_group("more"),
        lambda file: file["B"].attrs.__setitem__("unit", "V"),
        rename,
    ):
        with pytest.raises(InputError, match="checksum mismatch"):
            load(spoilt(change))
    load(spoilt(lambda file: file["provenance"].attrs.__setitem__("note", "by hand")))


def pair_file(path, nominal, perturbed):
    with h5py.File(path, "w") as file:
        for name, m in (("nominal", nominal), ("perturbed", perturbed)):
            for key in "ABCD":
                file[f"{name}/{key}"] = getattr(m, key)
            file[name].attrs["dt"] = m.dt
    return path


def test_pairs(model, tmp_path):
    other = StateSpaceModel(2 * A, B, C, D)
    path = pair_file(tmp_path / "p.h5", model, other)
    nominal, perturbed = read(path, isolate=False).object
    np.testing.assert_array_equal(perturbed.A, 2 * nominal.A)
    with pytest.raises(InputError, match=r"two models, /nominal and /perturbed.*\nhint: load\("):
        load(path)
    np.testing.assert_array_equal(load(path, group="perturbed").A, 2 * A)
    with pytest.raises(InputError, match=r"nominal has dt = 0 s, perturbed dt = 0\.5 s"):
        read(pair_file(tmp_path / "q.h5", model, StateSpaceModel(A, B, C, D, 0.5)), isolate=False)


def test_check_pair(model):
    check_pair(model, model.renamed(inputs=["u"]))  # a unit that is not stated agrees with every unit
    with pytest.raises(UnitMismatch, match=r"input u: nominal \[V\], perturbed \[mV\]"):
        check_pair(model, model.renamed(inputs=[("u", "mV")]))
    with pytest.raises(InputError, match="output 'phi' of nominal is 'omega' in perturbed"):
        check_pair(model, model.renamed(outputs=["omega"]))
    with pytest.raises(InputError, match="perturbed has 0 states, 1 inputs, 1 outputs"):
        check_pair(model, StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]]))


UNCERTAIN_FAULTS = [
    ("blocks/kind", ["imaginary"], "kind\\[0\\] is 'imaginary', expected real, complex or full"),
    ("blocks/rows", [2], "block 'k' \\(real\\) is 2 x 1"),
    ("blocks/rows", [1, 1], "rows has 2 entries, expected 1 as /blocks/name"),
    ("blocks/radius", [np.inf], "nominal 1, radius inf"),
    ("blocks/name", [""], "name ''"),
    ("blocks/name", [1.0], "/blocks/name has dtype float64, expected texts"),
    ("blocks/name", None, "missing /blocks/name"),
    ("blocks/below", [0.0], "width below: 0.0"),
    ("blocks/below", [np.inf], "width below: inf"),
    ("blocks/below", [0.1, 0.2], "below has 2 entries, expected 1 as /blocks/name"),
    ("blocks/below", ["x"], "/blocks/below has dtype .*, expected real numbers"),
    ("M/A", None, "missing /M/A"),
    ("M", None, "missing /M"),
]


@pytest.mark.parametrize(("path", "value", "text"), UNCERTAIN_FAULTS)
def test_bad_uncertain_files(path, value, text, tmp_path):
    m = StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    save(tmp_path / "p.h5", rl.UncertainModel(m, [rl.RealScalar("k", 1, rl.ParameterRange(1.0, 0.2, below=0.1))]))
    with h5py.File(tmp_path / "p.h5", "a") as file:
        del file[path]
        if value is not None:
            file[path] = value
        del file.attrs["content_sha256"]
    with pytest.raises(InputError, match=text):
        load(tmp_path / "p.h5")


def test_bad_controller_and_result_files(model, tmp_path):
    save(tmp_path / "c.h5", rl.Controller(model))
    with h5py.File(tmp_path / "c.h5", "a") as file:
        file.attrs["status"] = "splendid"
        del file.attrs["content_sha256"]
    with pytest.raises(InputError, match="status is 'splendid', expected one of certified"):
        load(tmp_path / "c.h5")


def test_signals_and_operating_point_must_fit(model, tmp_path):
    save(tmp_path / "p.h5", model)
    with h5py.File(tmp_path / "p.h5", "a") as file:
        del file.attrs["content_sha256"]
        del file["signals/input/unit"]
        file["signals/input/unit"] = ["V", "A"]
    with pytest.raises(InputError, match=r"/signals/input/unit has 2 entries, expected 1 as /signals/input/name"):
        load(tmp_path / "p.h5")


# --- where a loaded object comes from --------------------------------------------------------------------------------


def test_an_unverified_file_is_noted_in_all_files_made_of_it(tmp_path):
    model = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    rl.save(tmp_path / "good.h5", model)
    good = rl.load(tmp_path / "good.h5")
    assert good.provenance.created_by == "save"
    assert NOT_VERIFIED not in good.provenance.note
    with h5py.File(tmp_path / "good.h5", "r+") as file:
        del file.attrs["content_sha256"]
    with pytest.warns(UserWarning, match=r"good\.h5: the file carries no content_sha256"):
        bare = rl.load(tmp_path / "good.h5")
    assert (bare.provenance.created_by, bare.provenance.note) == ("save", NOT_VERIFIED)
    rl.save(tmp_path / "again.h5", bare)  # a hash over it proves nothing of where it came from
    again = read(tmp_path / "again.h5")
    assert again.verified
    assert again.object.provenance.note == f"made from a file {NOT_VERIFIED}"
    with h5py.File(tmp_path / "plain.h5", "w") as file:
        for name in "ABCD":
            file[name] = getattr(model, name)
    assert rl.load(tmp_path / "plain.h5").provenance.note == NOT_VERIFIED
    assert model.provenance is None


def test_every_kind_of_object_carries_it(tmp_path):
    motor = rl.plant("dc-motor", Kf=(4.8e-5, 0.35))
    things = [
        motor,
        motor.uncertain(),
        rl.Controller(motor.state_space()),
        rl.Record([0.0, 1.0], {}, {"q": [0.0, 1.0]}),
    ]
    for thing in things:
        rl.save(tmp_path / "x.h5", thing)
        assert rl.load(tmp_path / "x.h5", isolate=False).provenance.created_by == "save"
    (tmp_path / "r.csv").write_text("t,q\n0,1\n1,2\n")
    assert rl.load(tmp_path / "r.csv").provenance.note == NOT_VERIFIED
