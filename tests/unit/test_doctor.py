"""The doctor names what is missing and the package that brings it."""

from rtgi_addon import doctor


def test_missing_library_is_found_in_an_import_error():
    text = "libXrender.so.1: cannot open shared object file: No such file or directory"
    assert doctor.missing_libraries(text) == ["libXrender.so.1"]


def test_missing_libraries_are_found_in_a_listing_each_once():
    listing = "\tlibc.so.6 => /lib/libc.so.6 (0x1)\n" + "".join(
        f"\t{name} => not found\n" for name in ("libXi.so.6", "libSM.so.6", "libXi.so.6"))
    assert doctor.missing_libraries(listing) == ["libXi.so.6", "libSM.so.6"]


def test_mend_names_the_packages_of_known_libraries():
    assert doctor.mend_libraries(["libXi.so.6", "libSM.so.6"]) == "sudo apt-get install libsm6 libxi6"


def test_mend_names_an_unknown_library_itself():
    assert "libodd.so.3" in doctor.mend_libraries(["libodd.so.3"])


def test_missing_bpy_names_the_version_that_fits_this_python():
    problem, mend = doctor.bpy_problem(ModuleNotFoundError("No module named 'bpy'", name="bpy"))
    assert problem == "not installed" and "bpy==" in mend


def test_unwritable_cache_is_a_problem_with_a_mend(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "cache"))
    assert "NUMBA_CACHE_DIR" in doctor._cache().mend


def test_every_finding_of_this_machine_has_a_value():
    assert all(finding.what and finding.value for finding in doctor.examine())
