"""RPLIDAR capsules: known pairs decode to stated values, and no damaged byte ever becomes a measurement."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotd_devices.lidar import rplidar_samples as samples
from robotd_devices.lidar.rplidar_capsules import (
    DENSE,
    EXPRESS,
    FORMATS,
    TURN_Q6,
    ULTRA,
    ULTRA_DENSE,
    Capsule,
    CapsuleFormat,
    CapsuleParser,
    decode_capsule,
    is_sound,
    seal,
)
from robotd_devices.lidar.rplidar_fake import MODELS, RplidarFake
from robotd_devices.lidar.rplidar_wire import SCAN, express_scan, motor_rpm, request
from robotd_devices.ports.fakes import DAMAGES, Damage, damage

# computed pairs whose first capsule independent decoders read as stated; sources in docs/devices/rplidar.md
EXPRESS_A = bytes.fromhex(
    "a5590012e01a001b00241b441b00681b881b00ac1bcc1b00f01b141c00341c581c00781c9c1c00bc1ce01c00041d241d00481d681d00"
    "8c1dac1d00d01df41d00141e381e00581e7c1e009c1ec01e00e41e041f00"
)
EXPRESS_B = bytes.fromhex(
    "ab5ada18281f00000000000000000000000000f41f18200038205c20007c20a02000c020e4200008212821004c216c21009021b02100"
    "d421f8210018223c22005c22802200a022c42200e8220823002c234c2300"
)
ULTRA_A = bytes.fromhex(
    "aa5e00003507c0ff370700003817c0ff3a07c0ff3c0700003d1740fffb2280ff012380ff082340ff0f2380ff152380ff1c2340ff2323"
    "80ff293380ff302340ff372380ff3d3380ff442380ff4b2380ff513380ff582380ff5f2340ff662380ff6c2380ff732340ff7a2380ff"
    "803380ff872340ff8e2380ff943380ff9b2380ffa22340ff"
)
ULTRA_B = bytes.fromhex(
    "a456cc0aa92380ffaf2380ffb62340ffbd2380ffc33380ffca2380ffd12380ffd72380ffde2340ffe52380ffeb3380fff22380fff923"
    "40ff002480ff062480ff0d2440ff142480ff1a3480ff212480ff282440ff2f2480ff352480ff3c2440ff432480ff493480ff502480ff"
    "572440ff5e2480ff643480ff6b2440ff722480ff783480ff"
)
DENSE_A = bytes.fromhex(
    "a7580000e803eb03ef03f203f603fa03fd030104040408040c040f04130416041a041e042104250428042c043004330437043a043e04"
    "4204450449044c045004540457045b045e046204660469046d0470047404"
)
DENSE_B = bytes.fromhex(
    "aa52990377047b047f048204860489048d049104940498049b049f04a304a604aa04ad04b104b504b804bc04bf04c304c704ca04ce04"
    "d104d504d904dc04e004e304e704eb04ee04f204f504f904fd0400050405"
)
ULTRA_DENSE_A = bytes.fromhex(
    "ad54c0eb1200000000240d820d82cc11821182cc11821582cc15821582cc19821982cc1d821d82cc1d822182cc21822182cc25822582"
    "cc29822982cc29822d82cc2d822d82cc31823182cc35823582cc35823982cc39823982cc3d823d82cc3d824182cc41824582cc458245"
    "82cc49824982cc49824d82cc4d825182cc51825182cc55825582cc55825982cc59825d82cc5d825d82cc61826182cc61826582cc6582"
    "6982cc69826982cc"
)
ULTRA_DENSE_B = bytes.fromhex(
    "a15d80f312000000c9256d826d82cc6d827182cc71827582cc75827582cc79827982cc79827d82cc7d827d82cc81828182cc85828582"
    "cc85828982cc89828982cc8d828d82cc91829182cc91829582cc95829582cc99829982cc9d829d82cc9d82a182cca182a182cca582a5"
    "82cca982a982cca982ad82ccad82ad82ccb182b182ccb182b582ccb582b982ccb982b982ccbd82bd82ccbd82c182ccc182c582ccc582"
    "c582ccc982c982cc"
)

SAMPLE_NS = {0x82: 254e3, 0x84: 127e3, 0x85: 31.25e3, 0x86: 31.25e3}
MODEL = {0x82: ("a1", 1), 0x84: ("a1", 2), 0x85: ("s2", 1), 0x86: ("s3", 2)}


def stream(form: CapsuleFormat, count: int, first_deg: float = 0.0) -> list[bytes]:
    model, mode = MODEL[form.kind]
    fake = RplidarFake(model, first_deg=first_deg)
    fake.feed(motor_rpm(600) + express_scan(mode), 0)
    return [fake.next_capsule(form) for _ in range(count)]


def parser(form: CapsuleFormat) -> CapsuleParser:
    return CapsuleParser(form, 40_000, SAMPLE_NS[form.kind])


def whole(form: CapsuleFormat, capsule: Capsule) -> bytes:
    return capsule.start_q6.to_bytes(2, "little") + capsule.data


def told(form: CapsuleFormat, raw: bytes) -> bytes:
    return whole(form, decode_capsule(form, raw))


@pytest.mark.parametrize(
    ("form", "a", "b", "stated"),
    [
        (EXPRESS, EXPRESS_A, EXPRESS_B, {0: (4608, 6880), 1: (4662, 6912), 2: (4717, 6948), 31: (6307, 7940)}),
        (ULTRA, ULTRA_A, ULTRA_B, {0: (22545, 18080), 1: (22574, 18080), 2: (22603, 18112), 95: (2287, 5424)}),
        (DENSE, DENSE_A, DENSE_B, {0: (0, 4000), 1: (23, 4012), 2: (46, 4028), 39: (897, 4560)}),
        (
            ULTRA_DENSE,
            ULTRA_DENSE_A,
            ULTRA_DENSE_B,
            {0: (9216, 9756), 1: (9223, 9756), 2: (9230, 9768), 63: (9665, 10032)},
        ),
    ],
    ids=lambda value: value.name if isinstance(value, CapsuleFormat) else "",
)
def test_known_pairs(form: CapsuleFormat, a: bytes, b: bytes, stated: dict[int, tuple[int, int]]) -> None:
    assert is_sound(a)
    assert is_sound(b)
    one, two = decode_capsule(form, a), decode_capsule(form, b)
    got = samples.decode_samples(
        form, one.data, np.array([one.start_q6]), np.array([(two.start_q6 - one.start_q6) % TURN_Q6]), two.data
    )
    assert {i: (int(got.angle_q6[0, i]), int(got.distance_q2[0, i])) for i in stated} == stated
    assert got.angle_q6.shape == (1, form.samples)
    if form is ULTRA_DENSE:
        assert got.quality is not None
        assert set(got.quality.ravel().tolist()) == {200}
    found = CapsuleParser(form, 40_000, 254e3).feed(a + b + b[: form.angle_at + 2], 0)
    assert [whole(form, capsule) for capsule in found] == [told(form, a)]  # b is followed by its own angle


@pytest.mark.parametrize(
    ("raw", "words"),
    [(EXPRESS_A[:-1], "84 bytes"), (b"\xb5" + EXPRESS_A[1:], "b5 59"), (EXPRESS_A[:-1] + b"\x01", "no sound express")],
)
def test_decode_says_what_is_wrong(raw: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        decode_capsule(EXPRESS, raw)


@given(st.sampled_from(list(FORMATS.values())), st.data())
def test_sealed_is_sound_and_a_changed_byte_is_not(form: CapsuleFormat, draw: st.DataObject) -> None:
    data = draw.draw(st.binary(min_size=form.size - form.data_at, max_size=form.size - form.data_at))
    middle = bytes(form.data_at - 4)
    raw = seal(form, draw.draw(st.integers(0, TURN_Q6 - 1)), data, middle=middle)
    assert is_sound(raw)
    at, by = draw.draw(st.integers(0, form.size - 1)), draw.draw(st.integers(1, 255))
    assert not is_sound(raw[:at] + bytes((raw[at] ^ by,)) + raw[at + 1 :])


@pytest.mark.parametrize("form", FORMATS.values(), ids=lambda form: form.name)
def test_what_is_encoded_is_decoded(form: CapsuleFormat) -> None:
    rng = np.random.default_rng(1)
    mm = rng.choice([0, 100, 511, 513, 2000, 2047, 4100, 9000, 17000, 24568], size=form.samples)
    if form is EXPRESS:
        data = samples.encode_express(mm * 4 & 0xFFFC, np.arange(form.samples) * 2)
        mm = (mm * 4 & 0xFFFC) // 4
    elif form is ULTRA:
        mm = 3000 + rng.integers(-400, 400, size=form.samples)
        data = samples.encode_ultra(mm, 3000)
    elif form is DENSE:
        data = samples.encode_dense(mm)
    else:
        data = samples.encode_ultra_dense(mm * 4, np.full(form.samples, 160))
    behind = samples.encode_ultra(np.full(96, 3000), 3000) if form is ULTRA else b""
    got = samples.decode_samples(form, data, np.array([0]), np.array([1000]), behind)
    # the finest step at a distance: 1 mm; ultra 4 mm between 2 and 4 m; ultra-dense 2 to 5 mm
    coarse = {EXPRESS: 0, ULTRA: 7, DENSE: 0, ULTRA_DENSE: 5}[form]
    assert np.abs(got.distance_q2[0] / 4 - mm).max() <= coarse


@pytest.mark.parametrize("form", FORMATS.values(), ids=lambda form: form.name)
def test_a_clean_stream_is_whole_and_one_header_late(form: CapsuleFormat) -> None:
    sent = stream(form, 60)
    reader = parser(form)
    got: list[Capsule] = []
    for index, raw in enumerate(sent):
        got += reader.feed(raw[: form.angle_at + 2], 0)
        assert len(got) == (index if index > 1 else 0)
        got += reader.feed(raw[form.angle_at + 2 :], 0)
    assert [whole(form, capsule) for capsule in got] == [told(form, raw) for raw in sent[:-1]]
    assert [capsule.chained for capsule in got] == [False] + [True] * 58
    assert [capsule.first for capsule in got] == [True] + [False] * 58
    assert reader.faults == []


def test_a_whole_capsule_lost_is_not_hidden_between_its_neighbours() -> None:
    sent = stream(EXPRESS, 30)
    reader = parser(EXPRESS)
    got = reader.feed(b"".join(sent[:10] + sent[11:]), 0)
    # the one before the gap is followed by too wide an angle
    assert [whole(EXPRESS, c) for c in got] == [told(EXPRESS, raw) for raw in sent[:9] + sent[11:-1]]
    assert not got[9].chained
    assert reader.faults == ["no packet behind a packet"]


def test_a_head_that_stands_still_is_no_measurement() -> None:
    fake = RplidarFake("s2")
    fake.feed(motor_rpm(600) + express_scan(1), 0)
    fake.stalled = True
    reader = parser(DENSE)
    assert reader.feed(b"".join(fake.next_capsule(DENSE) for _ in range(20)), 0) == []
    assert reader.trouble == "not turning"


def test_noise_gives_nothing() -> None:
    assert parser(EXPRESS).feed(random.Random(7).randbytes(100_000), 0) == []


@given(
    st.sampled_from(list(FORMATS.values())),
    st.lists(st.integers(1, 300), min_size=1, max_size=20),
    st.integers(0, 2**32),
    st.sampled_from(DAMAGES),
    st.integers(0, 3),
)
def test_chunks_do_not_matter(form: CapsuleFormat, cuts: list[int], seed: int, kind: Damage, faults: int) -> None:
    rng = random.Random(seed)
    data = b"".join(STREAMS[form.kind])
    for _ in range(faults):
        data = damage(data, kind, rng)
    one, other = parser(form), parser(form)
    expected = [c._replace(arrival_ns=0) for c in one.feed(data, 0)]
    got, at, turn = [], 0, 0
    while at < len(data):
        size = cuts[turn % len(cuts)]
        got += [c._replace(arrival_ns=0) for c in other.feed(data[at : at + size], 0)]
        at, turn = at + size, turn + 1
    assert got == expected
    assert other.faults == one.faults


STREAMS = {kind: stream(form, 12, 350.0) for kind, form in FORMATS.items()}


@pytest.mark.parametrize("kind", DAMAGES)
@pytest.mark.parametrize("form", FORMATS.values(), ids=lambda form: form.name)
def test_no_damaged_capsule_is_accepted(form: CapsuleFormat, kind: Damage) -> None:
    """One fault in fifty capsules: nothing false comes through, and little that is true is lost."""
    rng = random.Random(f"{form.name} {kind}")
    sent = stream(form, 1000)
    place: dict[bytes, int] = {}
    pieces, faults, touched = [], 0, 0
    for at in range(0, len(sent), 50):
        bad = damage(b"".join(sent[at : at + 50]), kind, rng)
        faults += 1
        touched += sum(raw not in bad for raw in sent[at : at + 50])
        pieces.append(bad)
    for index, raw in enumerate(sent):
        place.setdefault(told(form, raw), index)
    got = [whole(form, capsule) for capsule in parser(form).feed(b"".join(pieces), 0)]
    assert [raw for raw in got if raw not in place] == []
    assert len(sent) - 1 - len(got) - touched <= 0.25 * faults


def test_the_models_scan_in_every_mode_that_they_name() -> None:
    for name, model in MODELS.items():
        for mode in model.modes:
            fake = RplidarFake(name)
            fake.feed(request(SCAN) if mode.number == 0 else express_scan(mode.number or 0), 0)
            assert fake.scanning == mode
