"""What a refusal looks like."""


def one_line(result, message):
    status, out, err = result
    assert (status, out) == (2, "")
    assert err.startswith("irisjax: ") and err.count("\n") == 1 and err.endswith("\n")
    assert message in err, err
