"""The run-time type checker of the test suite: shapes in annotations are checked, and an int may stand for a float."""

from beartype import BeartypeConf, beartype

check = beartype(conf=BeartypeConf(is_pep484_tower=True))
