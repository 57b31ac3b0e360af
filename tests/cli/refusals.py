"""What a refusal looks like."""


def one_line(result, *messages):
    status, out, err = result
    assert (status, out) == (2, "")
    assert err.startswith("irisjax: ") and err.count("\n") == 1 and err.endswith("\n")
    for message in messages:
        assert message in err, err
