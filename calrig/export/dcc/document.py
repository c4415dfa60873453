"""A certificate as a DCC. Every number in it is the certificate's own; nothing is computed here."""

import base64
from collections.abc import Sequence
from math import isfinite
from xml.etree import ElementTree as ET

from calrig.export.certificate.content import Certificate, EffectFound, Quantity, Standard
from calrig.export.dcc.elements import (
    DCC,
    SI,
    administrative_data,
    dcc,
    plain,
    quantity,
    real_list,
    rows,
    software,
    words,
    words_if,
)

FOUND, LEFT = "asFound", "asLeft"
"""Ids of the conditions under which errors are of the unit as it came, and with this calibration."""


def measurement_results(said: Certificate, document: bytes) -> ET.Element:
    """The second ring of a DCC.

    `document` is the calibration document as issued, which goes along whole.
    """
    results = [
        *_elevation(said),
        _figures("Bias and scale", said.results.line, "calrig_calibration", said),
        *(_effect(effect, "calrig_effect") for effect in said.results.effects),
        *(_effect(effect, "calrig_effectOfTheStage") for effect in said.results.of_stage),
        _points(said),
        _figures("RMS errors over the poses", said.results.figures, "calrig_rms", said),
        _budget(said),
        _document(document),
    ]
    return dcc(
        "measurementResults",
        dcc(
            "measurementResult",
            words("name", "Calibration of the elevation"),
            words("description", said.method.measurand, *said.judged),
            dcc("usedMethods", _method(said), _method_of_uncertainty(said)),
            dcc("usedSoftware", software(said)),
            _equipment(said),
            _conditions(said),
            dcc("results", *(one for one in results if one is not None)),
            id="results",
            refId="unit",
        ),
    )


def _method(said: Certificate) -> ET.Element:
    method = said.method
    return dcc(
        "usedMethod",
        words("name", f"Calibration of an IMU attitude sensor on a rotary stage, by {method.program}"),
        words("description", *method.procedure, *rows(method.plan)),
        *(dcc("reference", plain(one)) for one in method.literature[:1]),
    )


def _method_of_uncertainty(said: Certificate) -> ET.Element:
    return dcc(
        "usedMethod",
        words("name", "Measurement uncertainty"),
        words("description", *said.budget.method, *said.budget.not_contained),
        dcc("norm", "JCGM 100:2008"),
        *(dcc("reference", plain(one)) for one in said.method.literature[1:]),
        refType="basic_methodMeasurementUncertainty",
    )


def _equipment(said: Certificate) -> ET.Element:
    return dcc(
        "measuringEquipments",
        words_if("description", *rows(said.equipment)),
        *(_standard(one) for one in said.standards),
    )


def _standard(one: Standard) -> ET.Element:
    certificate = None
    said = [one.role, one.uncertainty]
    if one.certificate is not None and one.sha256 is not None:
        certificate = dcc(
            "certificate",
            words("referral", one.issued_by or "Certificate of calibration"),
            dcc("referralID", plain(one.certificate)),
            dcc("procedure", "SHA-256"),
            dcc("value", one.sha256),
            words_if("description", one.file),
            None if one.overdue is None else dcc("inValidityRange", "false" if one.overdue else "true"),
        )
    elif one.certificate is not None:
        said.append(f"Certificate {one.certificate}" + (f" of {one.issued_by}" if one.issued_by else ""))
    if one.issued_on is not None:
        said.append(f"Certificate issued {one.issued_on.isoformat()}")
    if one.due is not None:
        said.append(f"Due {one.due.isoformat()}" + (", and overdue when it was used" if one.overdue else ""))
    return dcc("measuringEquipment", words("name", one.what), words("description", *said), certificate)


def _conditions(said: Certificate) -> ET.Element:
    """The temperature, as found and as left: of one measurement, hence of one range."""
    conditions = []
    low, high = said.conditions.temperature_min_c, said.conditions.temperature_max_c
    for id_, status, what in (
        (FOUND, "beforeAdjustment", f"As found: by {said.results.found_by}"),
        (LEFT, "afterAdjustment", "As left: by this calibration, which who uses the unit applies"),
    ):
        known = [
            quantity(Quantity(name, title, value, "°C"), f"basic_temperature{end}")
            for name, end, title, value in (
                ("min", "Min", "Lowest temperature of the sensor's die", low),
                ("max", "Max", "Highest temperature of the sensor's die", high),
            )
            if value is not None
        ]
        conditions.append(
            dcc(
                "influenceCondition",
                words("name", "Temperature"),
                words("description", what, *rows(said.conditions.other)),
                dcc("status", status),
                dcc("data", *(known or [words("text", "The temperature was not measured.")])),
                id=id_,
                refType="basic_temperature",
            )
        )
    return dcc("influenceConditions", *conditions)


def _elevation(said: Certificate) -> list[ET.Element]:
    elevation = said.results.elevation
    if elevation is None:
        return []
    low, high = said.conditions.range_deg
    about = f"Expanded uncertainty of one elevation that the calibration gives, over {low:g}° to {high:g}°"
    figure = quantity(elevation, "calrig_elevation", _distribution(said), about)
    return [dcc("result", words("name", "Calibrated elevation"), dcc("data", figure))]


def _distribution(said: Certificate) -> str | None:
    """The distribution that k was taken from; None where the budget does not come down to one name."""
    if said.budget.expanded_deg is None:
        return None
    kinds = {line.distribution for line in said.budget.contributions if line.share > 0.0}
    return "rectangular+t" if "rectangular" in kinds else "t"


def _figures(name: str, figures: Sequence[Quantity], ref_type: str, said: Certificate) -> ET.Element | None:
    if not figures:
        return None
    entries = [quantity(one, f"{ref_type} calrig_{one.name}", _distribution(said)) for one in figures]
    return dcc("result", words("name", name), dcc("data", dcc("list", *entries)))


def _effect(effect: EffectFound, ref_type: str) -> ET.Element:
    figures = [quantity(one, f"calrig_{one.name}") for one in effect.parameters]
    formula = words("text", f"Added to the reading: {effect.formula}")
    return dcc(
        "result",
        words("name", effect.title),
        words("description", f"Origin: {effect.origin}"),
        dcc("data", formula, dcc("list", *figures) if figures else None),
        refType=f"{ref_type} calrig_{effect.name}",
    )


def _points(said: Certificate) -> ET.Element | None:
    points = [one for one in said.results.points if isfinite(one.found_deg) and isfinite(one.left_deg)]
    if not points:
        return None
    elevation, worth = said.results.elevation, None
    if elevation is not None and elevation.expanded is not None and (elevation.coverage_factor or 0.0) >= 1.0:
        factor, probability = elevation.coverage_factor or 1.0, elevation.coverage or 0.0
        worth = (elevation.expanded, factor, probability, _distribution(said))
    columns = dcc(
        "list",
        real_list("Elevation", [one.elevation_deg for one in points], "°", ref_type="basic_nominalValue"),
        real_list("Poses", [one.n_poses for one in points], "", ref_type="calrig_poses"),
        real_list(
            f"Mean error as found: by {said.results.found_by}",
            [one.found_deg for one in points],
            "°",
            ref_type="calrig_errorAsFound",
            ref_id=FOUND,
        ),
        real_list(
            "Mean error as left: by this calibration",
            [one.left_deg for one in points],
            "°",
            ref_type="basic_measurementError",
            ref_id=LEFT,
            worth=worth,
        ),
        refType="calrig_errors",
    )
    name = words("name", "Errors by elevation")
    return dcc("result", name, words("description", *said.results.points_say), dcc("data", columns))


def _budget(said: Certificate) -> ET.Element | None:
    lines = []
    for one in said.budget.contributions:
        freedom = "" if one.freedom is None else f", degrees of freedom {one.freedom:g}"
        about = f"{one.symbol}: type {one.type_}, {one.distribution}{freedom}, share {100 * one.share:.3g} %"
        figure = Quantity(one.symbol, one.title, one.contribution_deg, "°")
        lines.append(quantity(figure, "calrig_uncertaintyContribution", about=about))
    if not lines:
        return None
    name = words("name", "Uncertainty budget")
    said_of_it = "Standard uncertainty of a calibrated elevation from each contribution alone."
    return dcc(
        "result",
        name,
        words("description", said_of_it),
        dcc("data", dcc("list", *lines)),
        refType="calrig_uncertaintyBudget",
    )


def _document(content: bytes) -> ET.Element:
    attached = dcc(
        "byteData",
        dcc("fileName", "calibration.json"),
        dcc("mimeType", "application/json"),
        dcc("dataBase64", base64.b64encode(content).decode()),
    )
    name = words("name", "The calibration document as issued, for programs")
    return dcc("result", name, dcc("data", attached), refType="calrig_calibrationDocument")


VERSION = "3.2.1"
_INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"


def dcc_of(said: Certificate, document: bytes, country: str | None = None) -> bytes:
    """The XML: the same bytes for the same certificate.

    `document` is the calibration document as issued; `country` of the laboratory has two letters of ISO
    3166-1, None if not stated.
    """
    for prefix, namespace in (("dcc", DCC), ("si", SI), ("xsi", _INSTANCE)):
        ET.register_namespace(prefix, namespace)
    where = {f"{{{_INSTANCE}}}schemaLocation": f"{DCC} https://ptb.de/dcc/v{VERSION}/dcc.xsd"}
    root = dcc(
        "digitalCalibrationCertificate",
        administrative_data(said, country),
        measurement_results(said, document),
        schemaVersion=VERSION,
        **where,
    )
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"
