"""Short runs give the same bits with every library held back at once and with two threads; one library at a
time, and numba: `python data_scripts/same_bits.py`."""

from data_scripts import same_bits


def test_runs_do_not_depend_on_what_libraries_choose():
    settings = same_bits.settings()
    usual = same_bits.in_child({})
    assert {name.split("/")[0] for name in usual} == {"scenes", "photographs", "runs", "soups"}
    held_back = {name: value for variables in settings.values() for name, value in variables.items()}
    kept = {name: value for name, value in held_back.items() if not name.startswith("NUMBA")}
    assert same_bits.in_child(kept) == usual
