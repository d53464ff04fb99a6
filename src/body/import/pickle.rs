//! Reads Python pickles as plain data. Nothing is ever called: a global stays a name, and what would be built by a
//! call stays an [`Object`] with its callable's name, arguments and state.
//!
//! Protocols 0 to 5, without persistent objects' loading (the id is kept), extensions and out-of-band buffers.

use std::cell::RefCell;
use std::collections::HashMap;
use std::fmt;
use std::rc::Rc;

/// A value of a pickle; lists, dictionaries and objects are shared as they were in Python, and may hold themselves.
#[derive(Clone)]
pub enum Value {
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    /// `bytes`, or Python 2's `str`.
    Bytes(Rc<Vec<u8>>),
    Text(Rc<str>),
    List(Rc<RefCell<Vec<Value>>>),
    Tuple(Rc<Vec<Value>>),
    Dict(Rc<RefCell<Vec<(Value, Value)>>>),
    /// `module.name`
    Global(Rc<str>),
    Object(Rc<RefCell<Object>>),
}

/// What a call would have made.
#[derive(Clone, Debug)]
pub struct Object {
    pub callable: Value,
    pub args: Value,
    /// Set by `BUILD` (`__setstate__`).
    pub state: Value,
}

/// For errors: what it is, not what it holds, which may have no end.
impl fmt::Debug for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::None => f.write_str("None"),
            Value::Bool(value) => write!(f, "{value}"),
            Value::Int(value) => write!(f, "{value}"),
            Value::Float(value) => write!(f, "{value}"),
            Value::Bytes(bytes) => write!(f, "{} bytes", bytes.len()),
            Value::Text(text) => write!(f, "a text of {} bytes", text.len()),
            Value::List(items) => write!(f, "a list of {}", items.borrow().len()),
            Value::Tuple(items) => write!(f, "a tuple of {}", items.len()),
            Value::Dict(entries) => write!(f, "a dictionary of {}", entries.borrow().len()),
            Value::Global(name) => write!(f, "{name}"),
            Value::Object(_) => f.write_str("an object"),
        }
    }
}

impl Value {
    /// Text, or bytes that are text in Latin-1 (Python 2's strings).
    pub fn string(&self) -> Option<String> {
        match self {
            Value::Text(text) => Some(text.to_string()),
            Value::Bytes(bytes) => Some(bytes.iter().map(|&b| b as char).collect()),
            _ => None,
        }
    }

    pub fn int(&self) -> Option<i64> {
        match self {
            Value::Int(value) => Some(*value),
            Value::Bool(value) => Some(i64::from(*value)),
            _ => None,
        }
    }

    /// The elements of a list or tuple.
    pub fn items(&self) -> Option<Vec<Value>> {
        match self {
            Value::List(items) => Some(items.borrow().clone()),
            Value::Tuple(items) => Some(items.to_vec()),
            _ => None,
        }
    }

    /// The value of a dictionary's key.
    pub fn get(&self, key: &str) -> Option<Value> {
        let Value::Dict(entries) = self else { return None };
        entries.borrow().iter().rev().find(|(k, _)| k.is_text(key)).map(|(_, v)| v.clone())
    }

    fn is_text(&self, text: &str) -> bool {
        match self {
            Value::Text(own) => **own == *text,
            Value::Bytes(bytes) => bytes.as_slice() == text.as_bytes(),
            _ => false,
        }
    }
}

fn list(items: Vec<Value>) -> Value {
    Value::List(Rc::new(RefCell::new(items)))
}

fn tuple(items: Vec<Value>) -> Value {
    Value::Tuple(Rc::new(items))
}

fn text(bytes: &[u8]) -> Value {
    Value::Text(String::from_utf8_lossy(bytes).into())
}

fn object(callable: Value, args: Value) -> Value {
    Value::Object(Rc::new(RefCell::new(Object { callable, args, state: Value::None })))
}

/// A parsed pickle. What is cloned out of it is empty once it is gone.
#[derive(Debug)]
pub struct Pickle {
    pub value: Value,
    _kept: Kept,
}

/// Every list, tuple, dictionary and object, in the order of their making. Values may hold themselves, which counted references
/// never free, or lie deeper in each other than the stack reaches when they are freed: so they are emptied here, and then each is
/// freed alone, before those that it holds.
#[derive(Debug, Default)]
struct Kept(Vec<Value>);

impl Drop for Kept {
    fn drop(&mut self) {
        for value in &self.0 {
            match value {
                Value::List(items) => drop(items.take()),
                Value::Dict(entries) => drop(entries.take()),
                Value::Object(object) => {
                    drop(object.replace(Object { callable: Value::None, args: Value::None, state: Value::None }));
                }
                _ => {}
            }
        }
        while self.0.pop().is_some() {}
    }
}

/// Parses one pickle.
pub fn parse(bytes: &[u8]) -> Result<Pickle, String> {
    let mut machine =
        Machine { bytes, at: 0, stack: Vec::new(), marks: Vec::new(), memo: HashMap::new(), kept: Kept::default() };
    loop {
        let at = machine.at;
        match machine.step() {
            Ok(None) => {}
            Ok(Some(value)) => return Ok(Pickle { value, _kept: machine.kept }),
            Err(reason) => return Err(format!("pickle at byte {at}: {reason}")),
        }
    }
}

struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    stack: Vec<Value>,
    /// Stack heights at the marks.
    marks: Vec<usize>,
    memo: HashMap<u64, Value>,
    /// The last field, which outlives what the others hold.
    kept: Kept,
}

type Step<T> = Result<T, String>;

impl<'a> Machine<'a> {
    fn take(&mut self, n: usize) -> Step<&'a [u8]> {
        let end = self.at.checked_add(n).filter(|&end| end <= self.bytes.len()).ok_or("the file ends too early")?;
        let out = &self.bytes[self.at..end];
        self.at = end;
        Ok(out)
    }

    /// A little-endian unsigned number of `n` bytes.
    fn unsigned(&mut self, n: usize) -> Step<u64> {
        Ok(self.take(n)?.iter().rev().fold(0, |value, &b| value << 8 | u64::from(b)))
    }

    /// A block of bytes after its length of `n` bytes.
    fn block(&mut self, n: usize) -> Step<&'a [u8]> {
        let length = usize::try_from(self.unsigned(n)?).map_err(|e| e.to_string())?;
        self.take(length)
    }

    fn line(&mut self) -> Step<&'a [u8]> {
        let rest = &self.bytes[self.at..];
        let length = rest.iter().position(|&b| b == b'\n').ok_or("a line does not end")?;
        self.at += length + 1;
        Ok(rest[..length].strip_suffix(b"\r").unwrap_or(&rest[..length]))
    }

    fn number<T: std::str::FromStr>(&mut self) -> Step<T> {
        let line = self.line()?;
        let digits = line.strip_suffix(b"L").unwrap_or(line);
        std::str::from_utf8(digits).ok().and_then(|s| s.parse().ok()).ok_or_else(|| "not a number".to_owned())
    }

    fn pop(&mut self) -> Step<Value> {
        let floor = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() <= floor {
            return Err("the stack is empty".to_owned());
        }
        self.stack.pop().ok_or_else(|| "the stack is empty".to_owned())
    }

    fn top(&self) -> Step<&Value> {
        self.stack.last().ok_or_else(|| "the stack is empty".to_owned())
    }

    /// Everything above the last mark.
    fn pop_mark(&mut self) -> Step<Vec<Value>> {
        let mark = self.marks.pop().ok_or("no mark")?;
        if mark > self.stack.len() {
            return Err("the stack is empty".to_owned());
        }
        Ok(self.stack.split_off(mark))
    }

    fn push_tuple(&mut self, n: usize) -> Step<()> {
        let at = self.stack.len().checked_sub(n).ok_or("the stack is empty")?;
        let items = self.stack.split_off(at);
        self.push(tuple(items));
        Ok(())
    }

    fn push(&mut self, value: Value) {
        if matches!(value, Value::List(_) | Value::Tuple(_) | Value::Dict(_) | Value::Object(_)) {
            self.kept.0.push(value.clone());
        }
        self.stack.push(value);
    }

    fn remember(&mut self, key: u64) -> Step<()> {
        let value = self.top()?.clone();
        self.memo.insert(key, value);
        Ok(())
    }

    fn recall(&mut self, key: u64) -> Step<()> {
        let value = self.memo.get(&key).ok_or_else(|| format!("memo {key} is empty"))?;
        self.stack.push(value.clone());
        Ok(())
    }

    fn append(&mut self, items: Vec<Value>) -> Step<()> {
        match self.top()? {
            Value::List(list) => list.borrow_mut().extend(items),
            other => return Err(format!("cannot append to {other:?}")),
        }
        Ok(())
    }

    fn set_items(&mut self, items: Vec<Value>) -> Step<()> {
        let (pairs, rest) = items.as_chunks::<2>();
        if !rest.is_empty() {
            return Err("a key without a value".to_owned());
        }
        let pairs = pairs.iter().map(|[k, v]| (k.clone(), v.clone()));
        match self.top()? {
            Value::Dict(dict) => dict.borrow_mut().extend(pairs),
            // An `OrderedDict` and its like: what it was called with does not matter, its entries do.
            Value::Object(object) => {
                let mut object = object.borrow_mut();
                match &object.state {
                    Value::Dict(dict) => dict.borrow_mut().extend(pairs),
                    _ => object.state = Value::Dict(Rc::new(RefCell::new(pairs.collect()))),
                }
            }
            other => return Err(format!("cannot set an item of {other:?}")),
        }
        Ok(())
    }

    /// One instruction; the pickle's value after the last.
    fn step(&mut self) -> Step<Option<Value>> {
        let code = self.take(1)?[0];
        match code {
            b'.' => return self.pop().map(Some),
            0x80 => _ = self.take(1)?,
            0x95 => _ = self.take(8)?,
            b'(' => self.marks.push(self.stack.len()),
            b'0' => _ = self.pop()?,
            b'1' => _ = self.pop_mark()?,
            b'2' => self.stack.push(self.top()?.clone()),
            b'p' => self.number().and_then(|key| self.remember(key))?,
            b'q' => self.unsigned(1).and_then(|key| self.remember(key))?,
            b'r' => self.unsigned(4).and_then(|key| self.remember(key))?,
            0x94 => self.remember(self.memo.len() as u64)?,
            b'g' => self.number().and_then(|key| self.recall(key))?,
            b'h' => self.unsigned(1).and_then(|key| self.recall(key))?,
            b'j' => self.unsigned(4).and_then(|key| self.recall(key))?,
            b'a' => {
                let item = self.pop()?;
                self.append(vec![item])?;
            }
            b'e' | 0x90 => {
                let items = self.pop_mark()?;
                self.append(items)?;
            }
            b's' => {
                let (value, key) = (self.pop()?, self.pop()?);
                self.set_items(vec![key, value])?;
            }
            b'u' => {
                let items = self.pop_mark()?;
                self.set_items(items)?;
            }
            b'b' => {
                let state = self.pop()?;
                let Value::Object(object) = self.top()? else { return Err("only an object has a state".to_owned()) };
                object.borrow_mut().state = state;
            }
            0x85..=0x87 => self.push_tuple(usize::from(code - 0x84))?,
            _ => {
                let value = self.value(code)?;
                self.push(value);
            }
        }
        Ok(None)
    }

    /// The instructions that push one value.
    fn value(&mut self, code: u8) -> Step<Value> {
        Ok(match code {
            b'N' => Value::None,
            0x88 => Value::Bool(true),
            0x89 => Value::Bool(false),
            b'I' => match self.line()? {
                b"00" => Value::Bool(false),
                b"01" => Value::Bool(true),
                line => {
                    let number = std::str::from_utf8(line).ok().and_then(|s| s.parse().ok());
                    Value::Int(number.ok_or("not a number")?)
                }
            },
            b'L' => Value::Int(self.number()?),
            b'F' => Value::Float(self.number()?),
            b'J' => Value::Int(i64::from(self.unsigned(4)? as u32 as i32)),
            b'K' => Value::Int(self.unsigned(1)? as i64),
            b'M' => Value::Int(self.unsigned(2)? as i64),
            0x8a => long(self.block(1)?)?,
            0x8b => long(self.block(4)?)?,
            b'G' => Value::Float(f64::from_be_bytes(self.take(8)?.try_into().map_err(|_| "too short")?)),
            b'S' => Value::Bytes(Rc::new(unquote(self.line()?)?)),
            b'T' | b'B' => Value::Bytes(Rc::new(self.block(4)?.to_vec())),
            b'U' | b'C' => Value::Bytes(Rc::new(self.block(1)?.to_vec())),
            0x8e | 0x96 => Value::Bytes(Rc::new(self.block(8)?.to_vec())),
            b'V' => text(self.line()?),
            0x8c => text(self.block(1)?),
            b'X' => text(self.block(4)?),
            0x8d => text(self.block(8)?),
            b']' | 0x8f => list(Vec::new()),
            b')' => tuple(Vec::new()),
            b'}' => Value::Dict(Rc::default()),
            b'l' | 0x91 => list(self.pop_mark()?),
            b't' => tuple(self.pop_mark()?),
            b'd' => {
                let items = self.pop_mark()?;
                self.stack.push(Value::Dict(Rc::default()));
                self.set_items(items)?;
                self.pop()?
            }
            b'c' => {
                let (module, name) = (self.line()?, self.line()?);
                Value::Global(format!("{}.{}", module.escape_ascii(), name.escape_ascii()).into())
            }
            0x93 => {
                let (name, module) = (self.pop()?, self.pop()?);
                let (Some(module), Some(name)) = (module.string(), name.string()) else {
                    return Err("a global without a name".to_owned());
                };
                Value::Global(format!("{module}.{name}").into())
            }
            b'R' | 0x81 => {
                let (args, callable) = (self.pop()?, self.pop()?);
                object(callable, args)
            }
            0x92 => {
                let (_keywords, args, callable) = (self.pop()?, self.pop()?, self.pop()?);
                object(callable, args)
            }
            b'i' => {
                let (module, name) = (self.line()?, self.line()?);
                let callable = Value::Global(format!("{}.{}", module.escape_ascii(), name.escape_ascii()).into());
                object(callable, tuple(self.pop_mark()?))
            }
            b'o' => {
                let mut items = self.pop_mark()?;
                if items.is_empty() {
                    return Err("an object without a class".to_owned());
                }
                let callable = items.remove(0);
                object(callable, tuple(items))
            }
            b'P' => object(Value::None, text(self.line()?)),
            b'Q' => object(Value::None, self.pop()?),
            _ => return Err(format!("unknown instruction 0x{code:02x}")),
        })
    }
}

/// A little-endian two's-complement number of up to 8 bytes.
fn long(bytes: &[u8]) -> Step<Value> {
    let Some(&last) = bytes.last() else { return Ok(Value::Int(0)) };
    if bytes.len() > 8 {
        return Err("an integer of more than 64 bits".to_owned());
    }
    let start = if last & 0x80 != 0 { -1i64 } else { 0 };
    Ok(Value::Int(bytes.iter().rev().fold(start, |value, &b| value << 8 | i64::from(b))))
}

/// A string literal of protocol 0, as Python 2's `repr` wrote it.
fn unquote(line: &[u8]) -> Step<Vec<u8>> {
    let inner = match line {
        [first @ (b'\'' | b'"'), inner @ .., last] if first == last => inner,
        _ => return Err("a string without quotes".to_owned()),
    };
    let mut out = Vec::with_capacity(inner.len());
    let mut bytes = inner.iter().copied();
    while let Some(byte) = bytes.next() {
        if byte != b'\\' {
            out.push(byte);
            continue;
        }
        let escape = bytes.next().ok_or("a string ends in a backslash")?;
        out.push(match escape {
            b'n' => b'\n',
            b't' => b'\t',
            b'r' => b'\r',
            b'x' => {
                let digits = [bytes.next(), bytes.next()].map(|d| d.and_then(|d| (d as char).to_digit(16)));
                let [Some(high), Some(low)] = digits else { return Err("a broken \\x escape".to_owned()) };
                (high * 16 + low) as u8
            }
            other => other,
        });
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_data_of_protocol_2_comes_out() {
        // {'a': [1, -2, 300, 2.5, None, True], u'b': ('x', -1L)} by Python 2, protocol 2.
        let bytes = b"\x80\x02}q\x00(U\x01aq\x01]q\x02(K\x01J\xfe\xff\xff\xffM\x2c\x01G@\x04\x00\x00\x00\x00\x00\x00N\x88eX\x01\x00\x00\x00bq\x03U\x01x\x8a\x01\xff\x86q\x04u.";
        let pickle = parse(bytes).unwrap();
        let value = &pickle.value;
        let a = value.get("a").unwrap().items().unwrap();
        assert_eq!(a[..3].iter().map(|v| v.int().unwrap()).collect::<Vec<_>>(), [1, -2, 300]);
        assert!(matches!(a[3..], [Value::Float(2.5), Value::None, Value::Bool(true)]));
        let b = value.get("b").unwrap().items().unwrap();
        assert_eq!((b[0].string().unwrap().as_str(), b[1].int()), ("x", Some(-1)));
    }

    #[test]
    fn protocol_0_strings_are_unescaped_and_the_memo_shares() {
        let pickle = parse(b"(lp0\nS'a\\x41\\n\\\\\\''\np1\nag1\na.").unwrap();
        let items = pickle.value.items().unwrap();
        assert_eq!(items.iter().map(|v| v.string().unwrap()).collect::<Vec<_>>(), ["aA\n\\'", "aA\n\\'"]);
    }

    #[test]
    fn calls_are_kept_and_never_made() {
        let pickle = parse(b"cos\nsystem\n(S'true'\ntR.").unwrap();
        let Value::Object(object) = &pickle.value else { panic!("not an object") };
        let object = object.borrow();
        assert!(matches!(&object.callable, Value::Global(name) if &**name == "os.system"));
        assert_eq!(object.args.items().unwrap()[0].string().unwrap(), "true");
    }

    #[test]
    fn damage_is_an_error_and_never_a_panic() {
        for bytes in
            [&b""[..], b".", b"(", b"R.", b"q\x00.", b"h\x05.", b"T\xff\xff\xff\xffab.", b"]]s.", b"(K\x01d.", b"\xff."]
        {
            assert!(parse(bytes).is_err(), "{bytes:?}");
        }
    }
    #[test]
    fn what_holds_itself_is_freed() {
        // A list in itself; an object whose state is a dictionary that holds it.
        for bytes in [&b"\x80\x02]q\x00h\x00a."[..], b"\x80\x02cm\nn\n)\x81q\x00}K\x01h\x00sb."] {
            let pickle = parse(bytes).unwrap();
            let freed: Box<dyn Fn() -> bool> = match &pickle.value {
                Value::List(list) => {
                    let list = Rc::downgrade(list);
                    Box::new(move || list.upgrade().is_none())
                }
                Value::Object(object) => {
                    let object = Rc::downgrade(object);
                    Box::new(move || object.upgrade().is_none())
                }
                other => panic!("{other:?}"),
            };
            assert!(!freed());
            drop(pickle);
            assert!(freed(), "{bytes:?}");
        }
    }

    #[test]
    fn what_lies_deep_is_freed_without_a_stack_as_deep() {
        let deep = [b"N".as_slice(), &[0x85; 1_000_000]].concat();
        assert!(matches!(parse(&[&deep[..], b"."].concat()).unwrap().value, Value::Tuple(_)));
        assert!(parse(&[&deep[..], b"\xff"].concat()).is_err());
        let lists = [&[b']'; 1_000_000][..], &[b'a'; 999_999], b"."].concat();
        assert!(matches!(parse(&lists).unwrap().value, Value::List(_)));
    }
}
