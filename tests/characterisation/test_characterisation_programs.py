"""Commands, recipes and namings as they were; a file of its own, so that another process may take it."""

from characterisation.parametrised import check, recorded


@recorded("commands", "recipes", "naming")
def test_the_answer_is_as_it_was(subject, name):
    check(subject, name)
