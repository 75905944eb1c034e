use thiserror::Error;

use super::Number;

/// A formula that cannot be read or computed.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum FormulaError {
    /// It breaks the grammar.
    #[error("a formula cannot be read at character {at}: {what}")]
    Syntax {
        /// Character, from 0.
        at: usize,
        /// What is wrong there.
        what: &'static str,
    },
    /// It names something that is not declared.
    #[error("a formula uses {0:?}, which is no variable of its node")]
    Unknown(String),
    /// It divides by zero.
    #[error("a formula divides by zero")]
    DivisionByZero,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Binary {
    Or,
    And,
    BitOr,
    BitXor,
    BitAnd,
    Equal,
    Different,
    Less,
    Greater,
    AtMost,
    AtLeast,
    Left,
    Right,
    Add,
    Subtract,
    Multiply,
    Divide,
    Remainder,
    Power,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Unary {
    Minus,
    BitNot,
    Not,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Function {
    Sin,
    Cos,
    Tan,
    Asin,
    Acos,
    Atan,
    Abs,
    Exp,
    Ln,
    Lg,
    Sqrt,
    Trunc,
    Floor,
    Ceil,
    Round,
    Sign,
    Negate,
}

#[derive(Debug, Clone, PartialEq)]
enum Expr {
    Number(Number),
    Variable(usize),
    Unary(Unary, usize),
    Binary(Binary, usize, usize),
    Choice(usize, usize, usize),
    Call(Function, usize),
}

/// A formula of a SwissKnife or converter, read once. Its parts refer to each other by index, and
/// always to earlier ones; how deep they go is known and bounded.
#[derive(Debug, Clone, PartialEq)]
pub struct Formula {
    parts: Vec<Expr>,
    root: usize,
    depth: usize,
    variables: Vec<String>,
}

/// Deepest tree: a chain of additions is as deep as it is long.
const MAX_TREE: usize = 1000;

/// Deepest nesting of a formula: the deepest known has 30.
const MAX_DEPTH: usize = 200;

/// Operators by their binding, loosest first; longer spellings before their prefixes.
const LEVELS: [&[(&str, Binary)]; 10] = [
    &[("||", Binary::Or)],
    &[("&&", Binary::And)],
    &[("|", Binary::BitOr)],
    &[("^", Binary::BitXor)],
    &[("&", Binary::BitAnd)],
    &[("<>", Binary::Different), ("!=", Binary::Different), ("==", Binary::Equal), ("=", Binary::Equal)],
    &[("<=", Binary::AtMost), (">=", Binary::AtLeast), ("<", Binary::Less), (">", Binary::Greater)],
    &[("<<", Binary::Left), (">>", Binary::Right)],
    &[("+", Binary::Add), ("-", Binary::Subtract)],
    &[("*", Binary::Multiply), ("/", Binary::Divide), ("%", Binary::Remainder)],
];

/// What must not follow an operator for it to be this one.
fn is_other(operator: &str, rest: &str) -> bool {
    let next = rest[operator.len()..].chars().next();
    match operator {
        "|" => next == Some('|'),
        "&" => next == Some('&'),
        "<" => matches!(next, Some('<' | '=' | '>')),
        ">" => matches!(next, Some('>' | '=')),
        "*" => next == Some('*'),
        _ => false,
    }
}

struct Parser<'a> {
    text: &'a str,
    at: usize,
    depth: usize,
    parts: Vec<Expr>,
    depths: Vec<usize>,
    variables: Vec<String>,
}

impl Parser<'_> {
    fn rest(&mut self) -> &str {
        let rest = &self.text[self.at..];
        let trimmed = rest.trim_start();
        self.at += rest.len() - trimmed.len();
        trimmed
    }

    fn error(&self, what: &'static str) -> FormulaError {
        FormulaError::Syntax { at: self.at, what }
    }

    fn push(&mut self, part: Expr) -> usize {
        let below = match &part {
            Expr::Number(_) | Expr::Variable(_) => 0,
            Expr::Unary(_, a) | Expr::Call(_, a) => self.depths[*a],
            Expr::Binary(_, a, b) => self.depths[*a].max(self.depths[*b]),
            Expr::Choice(a, b, c) => self.depths[*a].max(self.depths[*b]).max(self.depths[*c]),
        };
        self.parts.push(part);
        self.depths.push(below + 1);
        self.parts.len() - 1
    }

    fn eat(&mut self, token: &str) -> bool {
        let found = self.rest().starts_with(token);
        if found {
            self.at += token.len();
        }
        found
    }

    fn nested<T>(
        &mut self,
        parse: impl FnOnce(&mut Self) -> Result<T, FormulaError>,
    ) -> Result<T, FormulaError> {
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            return Err(self.error("it is nested too deep"));
        }
        let result = parse(self);
        self.depth -= 1;
        result
    }

    fn choice(&mut self) -> Result<usize, FormulaError> {
        self.nested(|p| {
            let condition = p.binary(0)?;
            if !p.eat("?") {
                return Ok(condition);
            }
            let then = p.choice()?;
            if !p.eat(":") {
                return Err(p.error("':' is missing"));
            }
            let other = p.choice()?;
            Ok(p.push(Expr::Choice(condition, then, other)))
        })
    }

    fn binary(&mut self, level: usize) -> Result<usize, FormulaError> {
        let Some(operators) = LEVELS.get(level) else { return self.unary() };
        let mut left = self.binary(level + 1)?;
        loop {
            let rest = self.rest();
            let found = operators.iter().find(|(token, _)| rest.starts_with(token) && !is_other(token, rest));
            let Some((token, operator)) = found else { return Ok(left) };
            self.at += token.len();
            let right = self.binary(level + 1)?;
            left = self.push(Expr::Binary(*operator, left, right));
        }
    }

    fn unary(&mut self) -> Result<usize, FormulaError> {
        self.nested(|p| {
            if p.eat("+") {
                return p.unary();
            }
            for (token, operator) in [("-", Unary::Minus), ("~", Unary::BitNot), ("!", Unary::Not)] {
                if p.eat(token) {
                    let operand = p.unary()?;
                    return Ok(p.push(Expr::Unary(operator, operand)));
                }
            }
            let base = p.primary()?;
            if p.eat("**") {
                let exponent = p.unary()?;
                return Ok(p.push(Expr::Binary(Binary::Power, base, exponent)));
            }
            Ok(base)
        })
    }

    fn primary(&mut self) -> Result<usize, FormulaError> {
        if self.eat("(") {
            let inner = self.choice()?;
            return if self.eat(")") { Ok(inner) } else { Err(self.error("')' is missing")) };
        }
        let rest = self.rest();
        let Some(first) = rest.chars().next() else { return Err(self.error("it ends too early")) };
        if first.is_ascii_digit() || first == '.' {
            return self.number();
        }
        if !(first.is_alphabetic() || first == '_') {
            return Err(self.error("a number, a name or '(' is expected"));
        }
        let end = rest.find(|c: char| !(c.is_alphanumeric() || c == '_' || c == '.')).unwrap_or(rest.len());
        let name = rest[..end].to_owned();
        self.at += end;
        // A variable may be called E: it is a function only where brackets follow.
        if self.rest().starts_with('(') {
            return self.call(&name);
        }
        let index = self.variables.iter().position(|v| *v == name).unwrap_or_else(|| {
            self.variables.push(name);
            self.variables.len() - 1
        });
        Ok(self.push(Expr::Variable(index)))
    }

    fn number(&mut self) -> Result<usize, FormulaError> {
        let rest = self.rest().as_bytes();
        let hex = rest.len() > 1 && rest[0] == b'0' && (rest[1] | 0x20) == b'x';
        let mut end = if hex { 2 } else { 0 };
        while let Some(byte) = rest.get(end) {
            let exponent_sign =
                matches!(byte, b'+' | b'-') && !hex && end > 0 && (rest[end - 1] | 0x20) == b'e';
            let exponent = (byte | 0x20) == b'e';
            if !(byte.is_ascii_digit()
                || (hex && byte.is_ascii_hexdigit())
                || *byte == b'.'
                || exponent
                || exponent_sign)
            {
                break;
            }
            end += 1;
        }
        let (from, to) = (self.at, self.at + end);
        let value =
            Number::parse(&self.text[from..to]).ok_or_else(|| self.error("a number cannot be read"))?;
        self.at = to;
        // C's suffixes stand in some descriptions.
        while self.text[self.at..].starts_with(['U', 'u', 'L', 'l']) {
            self.at += 1;
        }
        Ok(self.push(Expr::Number(value)))
    }

    fn call(&mut self, name: &str) -> Result<usize, FormulaError> {
        self.eat("(");
        if self.eat(")") {
            return match name {
                "PI" => Ok(self.push(Expr::Number(Number::Float(std::f64::consts::PI)))),
                "E" => Ok(self.push(Expr::Number(Number::Float(std::f64::consts::E)))),
                _ => Err(self.error("a function of no arguments is not known")),
            };
        }
        let function = match name {
            "SIN" => Function::Sin,
            "COS" => Function::Cos,
            "TAN" => Function::Tan,
            "ASIN" => Function::Asin,
            "ACOS" => Function::Acos,
            "ATAN" => Function::Atan,
            "ABS" => Function::Abs,
            "EXP" => Function::Exp,
            "LN" => Function::Ln,
            "LG" => Function::Lg,
            "SQRT" => Function::Sqrt,
            "TRUNC" => Function::Trunc,
            "FLOOR" => Function::Floor,
            "CEIL" => Function::Ceil,
            "ROUND" => Function::Round,
            "SGN" => Function::Sign,
            "NEG" => Function::Negate,
            _ => return Err(self.error("a function is not known")),
        };
        let argument = self.choice()?;
        // ROUND may say to how many places.
        let argument = if function == Function::Round && self.eat(",") {
            let places = self.choice()?;
            let ten = self.push(Expr::Number(Number::Float(10.0)));
            let scale = self.push(Expr::Binary(Binary::Power, ten, places));
            let scaled = self.push(Expr::Binary(Binary::Multiply, argument, scale));
            let rounded = self.push(Expr::Call(Function::Round, scaled));
            self.push(Expr::Binary(Binary::Divide, rounded, scale))
        } else {
            self.push(Expr::Call(function, argument))
        };
        if self.eat(")") { Ok(argument) } else { Err(self.error("')' is missing")) }
    }
}

impl Formula {
    /// Reads a formula.
    ///
    /// # Errors
    /// [`FormulaError::Syntax`].
    pub fn parse(text: &str) -> Result<Self, FormulaError> {
        let mut parser =
            Parser { text, at: 0, depth: 0, parts: Vec::new(), depths: Vec::new(), variables: Vec::new() };
        let root = parser.choice()?;
        if !parser.rest().is_empty() {
            return Err(parser.error("an operator is expected"));
        }
        let depth = parser.depths[root];
        if depth > MAX_TREE {
            return Err(parser.error("it is too long"));
        }
        Ok(Self { parts: parser.parts, root, depth, variables: parser.variables })
    }

    /// How deep its parts go.
    pub const fn depth(&self) -> usize {
        self.depth
    }

    /// The names that it uses.
    pub fn variables(&self) -> &[String] {
        &self.variables
    }

    /// Its value. `variable` gives that of each name, by its place in [`Self::variables`]; it is asked
    /// only for those that count. With `float`, integers are taken as floats, as in a SwissKnife.
    ///
    /// # Errors
    /// [`FormulaError`] and those of `variable`.
    pub fn value<E: From<FormulaError>>(
        &self,
        float: bool,
        variable: &mut dyn FnMut(usize) -> Result<Number, E>,
    ) -> Result<Number, E> {
        self.part(self.root, float, variable)
    }

    fn part<E: From<FormulaError>>(
        &self,
        at: usize,
        float: bool,
        variable: &mut dyn FnMut(usize) -> Result<Number, E>,
    ) -> Result<Number, E> {
        let leaf = |n: Number| if float { Number::Float(n.float()) } else { n };
        match &self.parts[at] {
            Expr::Number(n) => Ok(leaf(*n)),
            Expr::Variable(index) => Ok(leaf(variable(*index)?)),
            Expr::Choice(condition, then, other) => {
                let chosen = if self.part(*condition, float, variable)?.is_true() { then } else { other };
                self.part(*chosen, float, variable)
            }
            Expr::Unary(operator, operand) => {
                let n = self.part(*operand, float, variable)?;
                Ok(match (operator, n) {
                    (Unary::Minus, Number::Int(i)) => Number::Int(i.wrapping_neg()),
                    (Unary::Minus, Number::Float(f)) => Number::Float(-f),
                    (Unary::BitNot, n) => Number::Int(!n.int()),
                    (Unary::Not, n) => Number::Int((!n.is_true()).into()),
                })
            }
            Expr::Call(function, argument) => {
                let n = self.part(*argument, float, variable)?;
                Ok(call(*function, n))
            }
            Expr::Binary(operator, left, right) => {
                let a = self.part(*left, float, variable)?;
                match operator {
                    Binary::And if !a.is_true() => return Ok(Number::Int(0)),
                    Binary::Or if a.is_true() => return Ok(Number::Int(1)),
                    _ => {}
                }
                let b = self.part(*right, float, variable)?;
                Ok(binary(*operator, a, b)?)
            }
        }
    }
}

fn call(function: Function, n: Number) -> Number {
    let x = n.float();
    let value = match function {
        Function::Sin => x.sin(),
        Function::Cos => x.cos(),
        Function::Tan => x.tan(),
        Function::Asin => x.asin(),
        Function::Acos => x.acos(),
        Function::Atan => x.atan(),
        Function::Exp => x.exp(),
        Function::Ln => x.ln(),
        Function::Lg => x.log10(),
        Function::Sqrt => x.sqrt(),
        Function::Abs => match n {
            Number::Int(i) => return Number::Int(i.wrapping_abs()),
            Number::Float(f) => f.abs(),
        },
        Function::Negate => match n {
            Number::Int(i) => return Number::Int(i.wrapping_neg()),
            Number::Float(f) => -f,
        },
        Function::Trunc => x.trunc(),
        Function::Floor => x.floor(),
        Function::Ceil => x.ceil(),
        Function::Round => x.round(),
        Function::Sign => f64::from(i8::from(x > 0.0) - i8::from(x < 0.0)),
    };
    Number::Float(value)
}

fn binary(operator: Binary, a: Number, b: Number) -> Result<Number, FormulaError> {
    let truth = |t: bool| Number::Int(t.into());
    let shift = |n: Number| u32::try_from(n.int()).unwrap_or(u32::MAX);
    let both = |int: fn(i64, i64) -> i64, float: fn(f64, f64) -> f64| match (a, b) {
        (Number::Int(x), Number::Int(y)) => Number::Int(int(x, y)),
        _ => Number::Float(float(a.float(), b.float())),
    };
    let compare = |int: fn(&i64, &i64) -> bool, float: fn(&f64, &f64) -> bool| match (a, b) {
        (Number::Int(x), Number::Int(y)) => truth(int(&x, &y)),
        _ => truth(float(&a.float(), &b.float())),
    };
    Ok(match operator {
        Binary::Or | Binary::And => truth(b.is_true()),
        Binary::BitOr => Number::Int(a.int() | b.int()),
        Binary::BitXor => Number::Int(a.int() ^ b.int()),
        Binary::BitAnd => Number::Int(a.int() & b.int()),
        Binary::Equal => compare(i64::eq, f64::eq),
        Binary::Different => compare(i64::ne, f64::ne),
        Binary::Less => compare(i64::lt, f64::lt),
        Binary::Greater => compare(i64::gt, f64::gt),
        Binary::AtMost => compare(i64::le, f64::le),
        Binary::AtLeast => compare(i64::ge, f64::ge),
        Binary::Left => Number::Int(a.int().checked_shl(shift(b)).unwrap_or(0)),
        // Masks are shifted down: what lies beyond the sign bit is a bit like the others.
        Binary::Right => {
            Number::Int(a.int().cast_unsigned().checked_shr(shift(b)).unwrap_or(0).cast_signed())
        }
        Binary::Add => both(i64::wrapping_add, |x, y| x + y),
        Binary::Subtract => both(i64::wrapping_sub, |x, y| x - y),
        Binary::Multiply => both(i64::wrapping_mul, |x, y| x * y),
        Binary::Divide | Binary::Remainder if !b.is_true() => return Err(FormulaError::DivisionByZero),
        Binary::Divide => both(i64::wrapping_div, |x, y| x / y),
        Binary::Remainder => both(i64::wrapping_rem, |x, y| x % y),
        Binary::Power => match (a, b) {
            (Number::Int(x), Number::Int(y)) if y >= 0 => u32::try_from(y)
                .ok()
                .and_then(|y| x.checked_pow(y))
                .map_or_else(|| Number::Float((x as f64).powf(y as f64)), Number::Int),
            _ => Number::Float(a.float().powf(b.float())),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn int(text: &str) -> Result<i64, FormulaError> {
        let formula = Formula::parse(text)?;
        let names = formula.variables().to_vec();
        let mut get = |i: usize| match names[i].as_str() {
            "A" => Ok(Number::Int(7)),
            "E" => Ok(Number::Int(3)),
            name => Err(FormulaError::Unknown(name.into())),
        };
        formula.value(false, &mut get).map(Number::int)
    }

    #[test]
    fn operators_bind_as_in_c_and_equal_is_one_sign() {
        for (text, wanted) in [
            ("1 + 2 * 3", 7),
            ("(1+2)*3", 9),
            ("2**3**2", 512),
            ("-2**2", -4),
            ("7 / 2", 3),
            ("A % 4 = 3", 1),
            ("A <> 7", 0),
            ("1 | 2 & 3 ^ 1", 3),
            ("1 << 4 + 1", 32),
            ("0xFFFFFFFFFFFFFFFF >> 63", 1),
            ("A > 5 ? 10 : 20", 10),
            ("0 ? 1 : 0 ? 2 : 3", 3),
            ("A && 0 || 1", 1),
            ("~0 & 0xFF", 255),
            ("E * 2", 6),
            ("TRUNC(E() * 10)", 27),
            ("ROUND(2.567, 2) * 100", 257),
            ("1e3 + 1.5", 1001),
            ("0 * 0x04", 0),
            ("(A>=7)&&(A<=7)", 1),
            ("A=7?(E=3?1:2):4", 1),
            ("SGN(-4)", -1),
            ("1 << 200", 0),
            ("0 && MISSING", 0),
        ] {
            assert_eq!(int(text), Ok(wanted), "{text}");
        }
    }

    #[test]
    fn what_is_wrong_is_an_error() {
        for text in ["", "1 +", "(1", "1 2", "FOO(1)", "?", "1 ? 2", "0x", "1.2.3", "é(", "$"] {
            assert!(Formula::parse(text).is_err(), "{text:?}");
        }
        assert_eq!(int("1 / 0"), Err(FormulaError::DivisionByZero));
        assert_eq!(int("B"), Err(FormulaError::Unknown("B".into())));
        assert!(Formula::parse(&"(".repeat(100_000)).is_err());
        assert!(Formula::parse(&"-".repeat(100_000)).is_err());
        assert!(Formula::parse(&format!("1{}", "+1".repeat(900))).is_ok());
        assert!(Formula::parse(&format!("1{}", "+1".repeat(100_000))).is_err());
    }

    #[test]
    fn a_swiss_knife_divides_as_floats() {
        let formula = Formula::parse("1/2 + (5 & 3)").expect("a formula");
        let value = formula.value::<FormulaError>(true, &mut |_| Ok(Number::Int(0)));
        assert_eq!(value, Ok(Number::Float(1.5)));
    }
}
