//! TOML whose lists have as many entries as are asked for: `serde` takes the first ones of a longer list for an array, and drops the others without a word.
//!
//! What reads is wrapped all the way down; whoever has read a list asks whether something is left.

use std::fmt;

use serde::de::{
    DeserializeOwned, DeserializeSeed, Deserializer, EnumAccess, Error as _, IgnoredAny, MapAccess, SeqAccess,
    VariantAccess, Visitor,
};

/// Reads `text`; a list with more entries than are taken of it is an error, as one with fewer is.
///
/// # Errors
/// What `T` refuses, with its place in the text.
pub fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, toml::de::Error> {
    T::deserialize(Exact(toml::Deserializer::parse(text)?))
}

/// What reads, or is read into, with all lists ended.
struct Exact<T>(T);

macro_rules! deserializing {
    ($($name:ident($($argument:ident: $kind:ty),*))*) => {
        $(fn $name<V: Visitor<'de>>(self, $($argument: $kind,)* visitor: V) -> Result<V::Value, D::Error> {
            self.0.$name($($argument,)* Exact(visitor))
        })*
    };
}

impl<'de, D: Deserializer<'de>> Deserializer<'de> for Exact<D> {
    type Error = D::Error;

    deserializing! {
        deserialize_any() deserialize_bool() deserialize_i8() deserialize_i16() deserialize_i32() deserialize_i64() deserialize_i128()
        deserialize_u8() deserialize_u16() deserialize_u32() deserialize_u64() deserialize_u128() deserialize_f32() deserialize_f64()
        deserialize_char() deserialize_str() deserialize_string() deserialize_bytes() deserialize_byte_buf() deserialize_option()
        deserialize_unit() deserialize_seq() deserialize_map() deserialize_identifier() deserialize_ignored_any()
        deserialize_unit_struct(name: &'static str) deserialize_newtype_struct(name: &'static str) deserialize_tuple(len: usize)
        deserialize_tuple_struct(name: &'static str, len: usize) deserialize_struct(name: &'static str, fields: &'static [&'static str])
        deserialize_enum(name: &'static str, variants: &'static [&'static str])
    }

    fn is_human_readable(&self) -> bool {
        self.0.is_human_readable()
    }
}

macro_rules! visiting {
    ($($name:ident: $kind:ty)*) => {
        $(fn $name<E: serde::de::Error>(self, value: $kind) -> Result<V::Value, E> {
            self.0.$name(value)
        })*
    };
}

impl<'de, V: Visitor<'de>> Visitor<'de> for Exact<V> {
    type Value = V::Value;

    visiting! {
        visit_bool: bool visit_i8: i8 visit_i16: i16 visit_i32: i32 visit_i64: i64 visit_i128: i128 visit_u8: u8 visit_u16: u16 visit_u32: u32
        visit_u64: u64 visit_u128: u128 visit_f32: f32 visit_f64: f64 visit_char: char visit_str: &str visit_borrowed_str: &'de str
        visit_string: String visit_bytes: &[u8] visit_borrowed_bytes: &'de [u8] visit_byte_buf: Vec<u8>
    }

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.expecting(formatter)
    }

    fn visit_none<E: serde::de::Error>(self) -> Result<V::Value, E> {
        self.0.visit_none()
    }

    fn visit_unit<E: serde::de::Error>(self) -> Result<V::Value, E> {
        self.0.visit_unit()
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<V::Value, D::Error> {
        self.0.visit_some(Exact(deserializer))
    }

    fn visit_newtype_struct<D: Deserializer<'de>>(self, deserializer: D) -> Result<V::Value, D::Error> {
        self.0.visit_newtype_struct(Exact(deserializer))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<V::Value, A::Error> {
        let mut list = Counted { list, taken: 0 };
        let value = self.0.visit_seq(&mut list)?;
        let mut all = list.taken;
        while list.list.next_element::<IgnoredAny>()?.is_some() {
            all += 1;
        }
        let expected = format!("an array of length {}", list.taken);
        if all == list.taken { Ok(value) } else { Err(A::Error::invalid_length(all, &expected.as_str())) }
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<V::Value, A::Error> {
        self.0.visit_map(Exact(map))
    }

    fn visit_enum<A: EnumAccess<'de>>(self, data: A) -> Result<V::Value, A::Error> {
        self.0.visit_enum(Exact(data))
    }
}

/// A list, and how many of its entries were taken.
struct Counted<A> {
    list: A,
    taken: usize,
}

impl<'de, A: SeqAccess<'de>> SeqAccess<'de> for Counted<A> {
    type Error = A::Error;

    fn next_element_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, A::Error> {
        let found = self.list.next_element_seed(Exact(seed))?;
        self.taken += usize::from(found.is_some());
        Ok(found)
    }

    fn size_hint(&self) -> Option<usize> {
        self.list.size_hint()
    }
}

impl<'de, S: DeserializeSeed<'de>> DeserializeSeed<'de> for Exact<S> {
    type Value = S::Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<S::Value, D::Error> {
        self.0.deserialize(Exact(deserializer))
    }
}

impl<'de, A: MapAccess<'de>> MapAccess<'de> for Exact<A> {
    type Error = A::Error;

    fn next_key_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, A::Error> {
        self.0.next_key_seed(seed)
    }

    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, A::Error> {
        self.0.next_value_seed(Exact(seed))
    }

    fn size_hint(&self) -> Option<usize> {
        self.0.size_hint()
    }
}

impl<'de, A: EnumAccess<'de>> EnumAccess<'de> for Exact<A> {
    type Error = A::Error;
    type Variant = Exact<A::Variant>;

    fn variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<(S::Value, Self::Variant), A::Error> {
        self.0.variant_seed(seed).map(|(value, variant)| (value, Exact(variant)))
    }
}

impl<'de, A: VariantAccess<'de>> VariantAccess<'de> for Exact<A> {
    type Error = A::Error;

    fn unit_variant(self) -> Result<(), A::Error> {
        self.0.unit_variant()
    }

    fn newtype_variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<S::Value, A::Error> {
        self.0.newtype_variant_seed(Exact(seed))
    }

    fn tuple_variant<V: Visitor<'de>>(self, len: usize, visitor: V) -> Result<V::Value, A::Error> {
        self.0.tuple_variant(len, Exact(visitor))
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, A::Error> {
        self.0.struct_variant(fields, Exact(visitor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, serde::Deserialize)]
    struct Below {
        pair: Option<[f64; 2]>,
        rows: Vec<[u32; 2]>,
        #[serde(default)]
        either: Option<Either>,
    }

    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Either {
        Size([f64; 3]),
        Sides { of: [i8; 1] },
        None,
    }

    #[derive(Debug, PartialEq, serde::Deserialize)]
    struct Top {
        three: [[f64; 3]; 1],
        #[serde(default)]
        below: Vec<Below>,
    }

    /// Fewer and more are refused alike, at any depth, at the list's place; what fits is read as it is without.
    #[test]
    fn lists_have_as_many_entries_as_arrays() {
        let good = "three = [[1, 2, 3]]\n[[below]]\npair = [1, 2]\nrows = [[1, 2], [3, 4]]\neither = { size = [1, 2, 3] }\n\
                    [[below]]\nrows = []\neither = { sides = { of = [7] } }\n[[below]]\nrows = []\neither = \"none\"\n";
        assert_eq!(from_toml::<Top>(good).expect("reads"), toml::from_str::<Top>(good).expect("reads"));
        let all = [
            ("three = [[1, 2, 3, 4]]", 1),
            ("three = [[1, 2]]", 1),
            ("three = [[1, 2, 3], [1, 2, 3]]", 1),
            ("three = [[1, 2, 3]]\n[[below]]\nrows = []\npair = [1, 2, 3]", 4),
            ("three = [[1, 2, 3]]\n[[below]]\nrows = [[1, 2], [3, 4, 5]]", 3),
            ("three = [[1, 2, 3]]\n[[below]]\nrows = []\neither = { size = [1, 2, 3, 4] }", 4),
            ("three = [[1, 2, 3]]\n[[below]]\nrows = []\neither = { sides = { of = [1, 2] } }", 4),
        ];
        for (text, line) in all {
            let error = crate::Error::toml("f.toml", text, &from_toml::<Top>(text).expect_err(text), "so").to_string();
            let said = error.contains(&format!("line {line}")) && error.contains("a list of ");
            assert!(said, "{text}: {error}");
        }
    }
}
