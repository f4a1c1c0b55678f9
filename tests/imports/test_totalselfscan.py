"""The authors' released layout: what comes out is the capture that went in, trap by trap."""


from capture_agreement import assert_same_capture, assert_same_head

from train.imports.totalselfscan import import_totalselfscan


def test_the_authors_folder_becomes_the_capture_that_it_was_written_from(authors, source, body, tmp_path):
    notes = import_totalselfscan(authors, tmp_path / "out", body=body)
    found = assert_same_capture(tmp_path / "out", source)
    assert_same_head(found, source)
    assert "not redistributable" in found.facts["body_licence"] and body.name in found.facts["body_licence"]
    assert found.facts["subject"] == "male-anna" and found.facts["notes"] == notes
