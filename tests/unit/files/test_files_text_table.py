"""Text tables of loggers and spreadsheets, and their faults."""

import numpy as np
import pytest

from robustlab.errors import InputError
from robustlab.files import read_table
from robustlab.record import Record

VALUES = [[0.0, 1.5, -2.0], [0.1, 2.5, 3e-3], [0.2, 3.5, 1e4]]

GOOD = {
    "commas": "t,u,q\n0,1.5,-2\n0.1,2.5,3e-3\n0.2,3.5,1E4\n",
    "blanks after commas": "t, u, q\n0, 1.5, -2\n0.1, 2.5, 3e-3\n0.2, 3.5, 1e4\n",
    "semicolons": "t;u;q\n0;1.5;-2\n0.1;2.5;3e-3\n0.2;3.5;1e4\n",
    "tabs": "t\tu\tq\n0\t1.5\t-2\n0.1\t2.5\t3e-3\n0.2\t3.5\t1e4\n",
    "white space": "  t   u  q\n  0   1.5 -2\n 0.1  2.5 3e-3\n0.2 3.5 1e4",
    "delimiter at the end": "t,u,q,\n0,1.5,-2,\n0.1,2.5,3e-3,\n0.2,3.5,1e4,\n",
    "Windows": "\ufefft,u,q\r\n0,1.5,-2\r\n0.1,2.5,3e-3\r\n0.2,3.5,1e4\r\n",
    "quoted": '"t","u","q"\n"0","1.5","-2"\n"0.1","2.5","3e-3"\n"0.2","3.5","1e4"\n',
    "comments": "# measured in May\n% by hand\nt,u,q\n0,1.5,-2\n# pause\n0.1,2.5,3e-3\n\n0.2,3.5,1e4\n",
    "header in a comment": "# a note\n# t u q\n0 1.5 -2\n0.1 2.5 3e-3\n0.2 3.5 1e4\n",
}


@pytest.mark.parametrize("name", GOOD)
def test_forms(name, tmp_path):
    (tmp_path / "r.csv").write_bytes(GOOD[name].encode())
    table = read_table(tmp_path / "r.csv")
    assert table.names == ("t", "u", "q")
    np.testing.assert_array_equal(table.values, VALUES)


@pytest.mark.parametrize("delimiter", [";", "\t", " "])
def test_decimal_comma_on_request(delimiter, tmp_path):
    rows = [delimiter.join(f"{x:g}".replace(".", ",") for x in row) for row in VALUES]
    (tmp_path / "r.txt").write_text("\n".join([delimiter.join("tuq"), *rows]))
    np.testing.assert_array_equal(read_table(tmp_path / "r.txt", decimal=",").values, VALUES)
    with pytest.raises(InputError, match=r"line 2, column 2 \(u\): decimal comma in '1,5'.*\nhint: decimal=','"):
        read_table(tmp_path / "r.txt")


def test_no_header_and_numpys_own_files(tmp_path):
    np.savetxt(tmp_path / "a.txt", VALUES)
    table = read_table(tmp_path / "a.txt")
    assert (table.names, table.has_header) == (("c1", "c2", "c3"), False)
    np.savetxt(tmp_path / "b.txt", VALUES, header="t u q", delimiter=" ")
    assert read_table(tmp_path / "b.txt").names == ("t", "u", "q")
    np.testing.assert_array_equal(read_table(tmp_path / "b.txt").values, VALUES)


def test_units_in_the_header(tmp_path):
    (tmp_path / "r.csv").write_text(
        "t [ms];torque (N m);phi [°];omega\n0;1;2;3\n1;1;2;3\n2;1;2;4\n", encoding="latin-1"
    )
    record = Record.read(tmp_path / "r.csv", inputs=["torque"])
    assert record.units == {"torque": "N m", "phi": "°", "omega": ""}
    np.testing.assert_allclose(record.t, [0, 1e-3, 2e-3], rtol=1e-15)
    assert (list(record.inputs), list(record.outputs)) == (["torque"], ["phi", "omega"])


BAD = [
    ("t,u\n0,1\n1\n2,3\n", r"line 3 has 1 cells, expected 2 as in line 2"),
    ("t,u\n0,1\n1,2,3\n", r"line 3 has 3 cells, expected 2 as in line 2"),
    ("t,u\n0,1\n1,x\n", r"line 3, column 2 \(u\): 'x', expected a number"),
    ("t,u\n0,1\n1,1_0\n", r"line 3, column 2 \(u\): '1_0', expected a number"),
    ("t,u,v\n0,1,2\n1,,2\n", r"line 3, column 2 \(u\): empty cell, expected a number"),
    ("t,u,u\n0,1,2\n", r"column name 'u' is used twice"),
    ("t,,u\n0,1,2\n", r"column 2 has no name"),
    ("t,u\n0,5,1,2\n", r"line 2 has 4 cells, the header in line 1 has 2.*\nhint: if the numbers have decimal commas"),
    ("# nothing\n\n", r"no numbers"),
    ("some prose\nand more\n", r"line 1: 'some prose', expected numbers"),
    ("Logger 7\nt,u\n0,1\n", r"line 1: 2 lines of text before the numbers"),
]


@pytest.mark.parametrize(("text", "pattern"), BAD)
def test_bad_tables_are_named_with_line_and_column(text, pattern, tmp_path):
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(InputError, match=r"r\.csv: " + pattern):
        read_table(tmp_path / "r.csv")


def test_binary_and_wide_text_are_refused(tmp_path):
    (tmp_path / "r.csv").write_bytes("t,u\n0,1\n".encode("utf-16"))
    with pytest.raises(InputError, match="UTF-16 text"):
        Record.read(tmp_path / "r.csv")
    (tmp_path / "r.csv").write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match="unknown binary format"):
        Record.read(tmp_path / "r.csv")
