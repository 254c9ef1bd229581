"""Numbers, statuses and verdicts as they were."""

from characterisation.parametrised import check, recorded


@recorded("bounds", "margins", "models", "sets", "records", "files", "designs", "robust_designs", "campaign")
def test_the_answer_is_as_it_was(subject, name):
    check(subject, name)
