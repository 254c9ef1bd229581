"""Numbers, statuses and verdicts as they were at revision 3842bc3f: no judge of what is right.

``data/SUBJECT.json`` holds a case a line, with its CPU time; ``cases.py`` compares two answers. Fast and
slow are CPU s in all:

================ ========================================================== ============================= ==============
subject          what                                                       tolerance                     fast, slow
================ ========================================================== ============================= ==============
bounds           mu of 42 matrices of ten kinds of structure                brackets                      3
margins          margin and worst gain of 15 sets; loops; distances         brackets                      5, 35
models           norms of 200 models of ten kinds; 30 reductions            brackets; H2 1e-6             2
sets             15 exact sets; covers, samples, worst members,             residual 0; 1e-9, searches    5
                 probabilities                                              1e-6
records          3 comparisons; 12 validations                              1e-6; brackets                4, 14
files            15 HDF5 files, one a kind: they load for ever              1e-12                         1
designs          H-infinity and H2 of 56 COMPleib plants, with their        1e-3; H2 too; proved or not   2, 110
                 evidence checked (shared data)
robust_designs   12 D-K                                                     1e-3                          4, 60
campaign         3000 samples, killed twice and resumed                     1e-9, same bits               -, 10
commands         exit codes and ``--json`` of 88 commands in 8 chapters     1e-6; brackets; gamma 1e-3    9, 120
recipes          9 recipes: verdicts, statuses, numbers                     1e-6 to 2e-2 (names, fits)    5, 830
naming           11 blind cases: verdict, kinds, effects, values, work      2 %, gaps 1 %, work 1.3 x     -, 170
================ ========================================================== ============================= ==============

Where an answer changes for a reason, it is recorded anew::

    python tests/characterisation                     # the fast part: subject, cases, equal, different, CPU s
    python tests/characterisation --all > table.txt   # everything
    python tests/characterisation designs --record --all --case AC1
"""

from characterisation.parametrised import check, recorded


@recorded("bounds", "margins", "models", "sets", "records", "files", "designs", "robust_designs", "campaign")
def test_the_answer_is_as_it_was(subject, name):
    check(subject, name)
