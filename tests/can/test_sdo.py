"""SDO messages, compared with messages of CiA 301 written out by hand."""

from __future__ import annotations

import canopen

from thorvaldc.can import sdo


def test_sdo_requests_and_aborts() -> None:
    assert sdo.upload_request(0x1018, 4) == bytes.fromhex("4018100400000000")
    abort = sdo.abort_message(0x2345, 1, sdo.AbortCode.OBJECT_UNKNOWN)
    assert abort == bytes.fromhex("8045230100000206")
    assert sdo.abort_code(abort) == sdo.AbortCode.OBJECT_UNKNOWN
    assert sdo.abort_code(bytes.fromhex("4318100401000000")) is None


def test_every_abort_code_has_a_text() -> None:
    assert sdo.abort_text(0x06090030) == "the value is out of range (SDO abort 0x06090030)"
    texts = {sdo.abort_text(code).partition(" (")[0] for code in sdo.AbortCode}
    assert len(texts) == len(sdo.AbortCode)
    assert sdo.abort_text(0x12345678) == "aborted (SDO abort 0x12345678)"


def test_abort_codes_are_those_of_the_standard() -> None:
    """The library knows all but ``HARDWARE_ERROR``, the code for a fault of the hardware."""
    named = {code for code in sdo.AbortCode if code not in canopen.SdoAbortedError.CODES}
    assert named <= {0x06060000}


def test_expedited_messages_of_every_length() -> None:
    commands = [(b"\x01", 0x2F), (b"\x01\x02", 0x2B), (b"\x01\x02\x03", 0x27), (bytes(4), 0x23)]
    for data, command in commands:
        request = sdo.download_request(0x1017, 0, data)
        assert request == bytes([command, 0x17, 0x10, 0]) + data.ljust(4, b"\0")
        response = sdo.upload_response(0x1017, 0, data)
        assert response[0] == command + 0x20
        assert sdo.is_expedited(response)
        assert sdo.expedited_data(response) == sdo.expedited_data(request) == data
    assert sdo.download_response(0x1017, 0) == bytes.fromhex("6017100000000000")


def test_a_text_in_segments() -> None:
    response = sdo.upload_response(0x1008, 0, b"thorvald!")
    assert response == bytes.fromhex("4108100009000000")
    assert not sdo.is_expedited(response)
    assert sdo.upload_segment_request(0) == bytes.fromhex("6000000000000000")
    assert sdo.upload_segment_request(1) == bytes.fromhex("7000000000000000")
    first = sdo.upload_segment_response(0, b"thorval", last=False)
    second = sdo.upload_segment_response(1, b"d!", last=True)
    assert (first[0], second[0]) == (0x00, 0x1B)
    assert [sdo.segment_toggle(m) for m in (first, second)] == [0, 1]
    assert [sdo.is_last_segment(m) for m in (first, second)] == [False, True]
    assert sdo.segment_data(first) + sdo.segment_data(second) == b"thorvald!"
    assert sdo.download_segment_response(1) == bytes.fromhex("3000000000000000")


def test_numbers() -> None:
    assert sdo.encode_number("integer16", -2) == b"\xfe\xff"
    assert sdo.decode_number("integer16", b"\xfe\xff\0\0") == -2
    assert sdo.decode_number("unsigned32", b"\x69\x04") == 0x469
