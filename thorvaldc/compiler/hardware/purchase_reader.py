"""Reads prices, suppliers and lead times of modules.

A module document states them in its section `purchase`.  The section `purchase` of a robot document
states or replaces them for a module type or for one module.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from thorvaldc.compiler.modules.library import Library, ModuleType
from thorvaldc.compiler.modules.module_tree import Instance
from thorvaldc.compiler.source.node import Node, describe_node, insertion
from thorvaldc.compiler.values.value_reader import INVALID, ValueReader, entries
from thorvaldc.diagnostics import Proposal, Report, did_you_mean
from thorvaldc.model import Purchase

_ISO_4217 = """
AED AFN ALL AMD AOA ARS AUD AWG AZN BAM BBD BDT BHD BIF BMD BND BOB BRL BSD BTN BWP BYN BZD CAD
CDF CHF CLP CNY COP CRC CUP CVE CZK DJF DKK DOP DZD EGP ERN ETB EUR FJD FKP GBP GEL GHS GIP GMD
GNF GTQ GYD HKD HNL HTG HUF IDR ILS INR IQD IRR ISK JMD JOD JPY KES KGS KHR KMF KPW KRW KWD KYD
KZT LAK LBP LKR LRD LSL LYD MAD MDL MGA MKD MMK MNT MOP MRU MUR MVR MWK MXN MYR MZN NAD NGN NIO
NOK NPR NZD OMR PAB PEN PGK PHP PKR PLN PYG QAR RON RSD RUB RWF SAR SBD SCR SDG SEK SGD SHP SLE
SOS SRD SSP STN SVC SYP SZL THB TJS TMT TND TOP TRY TTD TWD TZS UAH UGX USD UYU UZS VES VND VUV
WST XAF XCD XCG XOF XPF YER ZAR ZMW ZWG
"""
# The active codes, without those of funds, metals and tests.
CURRENCIES = tuple(_ISO_4217.split())
MAX_AMOUNT = 1e12
_MONEY = re.compile(r"(\d+(?:\.\d+)?) *([A-Za-z]+)", re.ASCII)
_SYMBOLS = {"€": "EUR", "$": "USD", "£": "GBP", "¥": "JPY"}


class Money(NamedTuple):
    """An amount of money in a currency (ISO 4217)."""

    amount: float
    currency: str


class MoneyError(Exception):
    """Exception: a text is no amount of money.  ``hint``: how to write it."""

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.hint = hint


def parse_money(text: str) -> Money:
    """Returns the amount and the currency of a text such as ``1250 EUR``.

    Raises ``MoneyError`` if the text is no amount with a code of ISO 4217.
    """
    match = _MONEY.fullmatch(text.strip())
    if match is None:
        for symbol, code in _SYMBOLS.items():
            number = text.replace(symbol, "").strip()
            if symbol in text and re.fullmatch(r"\d+(\.\d+)?", number, re.ASCII):
                hint = Proposal(f"write `{number} {code}`", f"{number} {code}")
                raise MoneyError(f"`{text}` has no code of a currency", hint)
        numbers = re.findall(r"\d[\d.,]*", text, re.ASCII) or ["1250"]
        example = f"{numbers[0]} EUR"
        advice: str = "write an amount and a currency, such as `1250 EUR`"
        if len(numbers) == 1 and _MONEY.fullmatch(example) is not None:
            advice = Proposal(advice.replace("1250 EUR", example), example, is_example=True)
        raise MoneyError(f"`{text}` is no amount with a currency", advice)
    amount, currency = float(match[1]), match[2]
    if currency not in CURRENCIES:
        near = _currency_hint(currency)
        raise MoneyError(
            f"`{currency}` is no currency of ISO 4217",
            near.within(text) if isinstance(near, Proposal) else near,
        )
    if amount > MAX_AMOUNT:
        raise MoneyError(f"`{text}` is more than {MAX_AMOUNT:g}", "write a smaller amount")
    return Money(amount, currency)


def _currency_hint(currency: str) -> str:
    return did_you_mean(currency, CURRENCIES) or "write the code of ISO 4217, such as `EUR`"


def read_purchase(section: Node, reader: ValueReader, report: Report) -> Purchase:
    """Returns the purchase data of a section `purchase`, or of one entry of it."""
    money = _money(section, reader, report)
    lead_time = section.get("lead_time")
    return Purchase(
        money.amount if money is not None else None,
        money.currency if money is not None else "",
        reader.text(section.get("supplier")),
        _lead_time(lead_time, reader, report) if lead_time is not None else None,
    )


def _money(section: Node, reader: ValueReader, report: Report) -> Money | None:
    price, currency_node = section.get("price"), section.get("currency")
    value = reader.evaluate(price) if price is not None else None
    if price is None or value is None:
        return None
    currency = reader.text(currency_node)
    if isinstance(value, int | float) and not isinstance(value, bool):
        if not reader.has_dimension(price, quantity="number"):
            return None
        return _amount(value, currency, section, report)
    if not isinstance(value, str):
        message = f"{describe_node(price)} is no amount with a currency"
        report.add("price-invalid", message, price.span, hint="write it as in: 1250 EUR")
        return None
    try:
        money = parse_money(value)
    except MoneyError as error:
        report.add("price-invalid", str(error), price.span, hint=error.hint)
        return None
    if currency_node is not None and money.currency != currency:
        message = f"the price is in {money.currency}, and `currency` is {currency}"
        report.add("price-invalid", message, currency_node.span, hint="remove `currency`")
        return None
    return money


def _amount(amount: float, currency: str, section: Node, report: Report) -> Money | None:
    """Returns a price that is a number, with its currency beside it."""
    node = section.get("currency")
    place = node if node is not None else section.get("price") or section
    hint: str | None = None
    if node is None:
        message = "the price has no currency"
        hint = insertion("add the currency", section, "currency", "EUR", is_example=True)
    elif currency not in CURRENCIES:
        message, hint = f"`{currency}` is no currency of ISO 4217", _currency_hint(currency)
    elif not 0.0 <= amount <= MAX_AMOUNT:
        message = f"the price is {amount:g}; it must be from 0 to {MAX_AMOUNT:g}"
    else:
        return Money(float(amount), currency)
    report.add("price-invalid", message, place.span, hint=hint)
    return None


def _lead_time(node: Node, reader: ValueReader, report: Report) -> float | None:
    """Returns a lead time in s."""
    if isinstance(node.value, int | float) and not isinstance(node.value, bool) and node.value:
        report.add(
            "bad-quantity",
            f"the lead time `{node.value:g}` has no unit",
            node.span,
            hint=Proposal(f"write `{node.value:g} d` if days are meant", f"{node.value:g} d"),
        )
        return None
    value = reader.value(node)
    if value is INVALID or value is None:
        return None
    lead_time = reader.quantity(node, "time")
    if lead_time < 0.0:
        report.add("out-of-range", "the lead time is negative", node.span)
        return None
    return lead_time


# -- the section of a robot document ---------------------------------------------------


def read_purchases(
    document: Node, robot: Instance, library: Library, reader: ValueReader, report: Report
) -> dict[str, Purchase]:
    """Returns the purchase data in a robot document, by the module type or the path of a module."""
    purchases: dict[str, Purchase] = {}
    leaves = {leaf.path: leaf for leaf in robot.leaves()}
    for name, node in entries(document.get("purchase")).items():
        if "/" in name:
            module: ModuleType | None = library.load(name, node, report)
            is_assembly = module is not None and module.is_assembly
        else:
            is_assembly = any(path.startswith(f"{name}.") for path in leaves)
            if not is_assembly and name not in leaves:
                report.add(
                    "module-unknown",
                    f"the robot has no module `{name}`",
                    node.where,
                    hint=did_you_mean(name, leaves, "name a module or a module type"),
                )
        if is_assembly:
            report.add(
                "price-invalid",
                f"`{name}` is an assembly; its parts have prices",
                node.where,
                hint="`thorvaldc info` lists the parts: state the price of each type",
            )
        purchases[name] = read_purchase(node, reader, report)
    return purchases
